"""Conditions for build pipelines: what they mean, and that no text does anything but mean something or be refused."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mipbake import UsageError
from mipbake.comparing.conditions import EXAMPLE, GRAMMAR, Condition, parse
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import SCALES, Figure, Method

NAN = math.nan


def of(method: str, measure: str, view: str, scale: str, value: float, lod: float = 0.0) -> Figure:
    return Figure(method, measure, view, scale, lod, value, value - 1, value + 1)


METHODS = ("neural", "linear (box)", "lean (blackman-harris)", "optimum")


def comparison(subject: str = "neural") -> Comparison:
    """SNR of neural 12, linear 10, LEAN 11, the optimum 20 near the mirror; hemisphere 20 more; 1 less a lod."""
    snr = dict(zip(METHODS, (12.0, 10.0, 11.0, 20.0), strict=True))
    flip = dict(zip(METHODS, (0.10, 0.30, 0.20, 0.05), strict=True))
    flicker = dict(zip(METHODS, (1.5, 3.0, 0.5, 1.0), strict=True))
    figures = []
    for name in METHODS:
        for scale, (lod, _) in SCALES.items():
            figures += [of(name, "snr", "near-mirror", scale, snr[name] - lod, lod)]
            figures += [of(name, "snr", "hemisphere", scale, snr[name] - lod + 20, lod)]
            figures += [of(name, "flicker", "near-mirror", scale, flicker[name], lod)]
            figures += [of(name, "flicker", "hemisphere", scale, NAN if scale == "far" else 2 * flicker[name], lod)]
        figures += [of(name, "flip", "sphere", scale, flip[name]) for scale in ("near", "far")]
        figures += [of(name, "tonemapped", "sphere", "near", flip[name] / 2), of(name, "flip", "plane", "", 0.5)]
        figures += [of(name, "jod-37", "film-floor", "", 10 - 5 * flip[name]), of(name, "snr", "film-floor", "", 9.0)]
    return Comparison(
        name="set",
        subject=subject,
        model="gltf",
        pixel_filter="gaussian",
        methods=tuple(Method(name, name.split(" ")[0], "box", "gltf") for name in METHODS),
        curve=tuple(
            of(name, "snr", "near-mirror", "", snr[name] - lod, lod) for name in METHODS for lod in (0, 0.25, 0.5)
        ),
        figures=tuple(figures),
    )


@pytest.mark.parametrize(
    ("text", "failed", "value"),
    [
        ("snr near-mirror lod=0 < 12", False, 12),
        ("snr near-mirror lod=0 <= 12", True, 12),
        ("  near-mirror  snr lod=0.50<1.2e1  ", True, 11.5),
        ("measure=snr view=near-mirror lod=.25 < -3.5", False, 11.75),
        ("snr hemisphere 1:1 < 33", True, 32),
        ("snr near-mirror near > 11", True, 12),
        ("snr near-mirror lod=0 method='linear (box)' < 11", True, 10),
        ("snr near-mirror lod=0 over 'lean (blackman-harris)' < 2", True, 1),
        ("snr near-mirror lod=0 over best < 1", False, 1),
        ("optimum snr near-mirror lod=0 over neural > 7", True, 8),
        ("flip sphere near over best > 0", False, -0.1),
        ("flip plane < 0.6", True, 0.5),
        ("best flicker near-mirror near < 1", True, 0.5),  # 3 is further from 1 than 1/2 is
        ("jod-37 film-floor over best < 0", False, 0.5),  # 9.5 and LEAN's 9, the better of two
        ("jod-37 < 9", False, 9.5),  # it was measured for one film only
    ],
)
def test_conditions_mean_what_they_say(text: str, failed: bool, value: float) -> None:
    outcome = parse(text).check(comparison())
    assert outcome.value == pytest.approx(value)
    assert outcome.failed == failed
    assert ("does not hold" in outcome.sentence) != failed
    assert repr(text) in outcome.sentence


def test_sentences_say_whose_figure_it_is() -> None:
    said = parse("snr near-mirror near over linear (box) < 1").check(comparison()).sentence
    assert "SNR of neural (near-mirror, near) is 12 dB (95 % interval 11 to 13)" in said
    assert "and linear (box) has 10 dB" in said and "the difference is 2" in said
    assert "FLIP of neural (plane) is 0.5" in parse("flip plane > 1").check(comparison()).sentence
    curve = parse("snr near-mirror lod=0.25 > 1").check(comparison()).sentence
    assert "SNR of neural (near-mirror, lod 0.25) is 11.75 dB" in curve


def test_what_is_not_a_number_fails_the_build() -> None:
    for text in ("flicker hemisphere far < 1", "flicker hemisphere far over best >= 1"):
        outcome = parse(text).check(comparison())
        assert outcome.failed and math.isnan(outcome.value)
        assert "cannot be decided, which counts as failed" in outcome.sentence and "is nan" in outcome.sentence


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected words, one of <"),
        ("snr near-mirror lod=0 = 12", "expected words, one of <"),
        ("snr lod=0 < ", "'' is not a number"),
        ("snr lod=0 < nan", "'nan' is not a number"),
        ("over best < 12", "it does not say which figure"),
        ("snr over < 12", "expected a method behind over"),
        ("snr 'linear < 12", "a quotation has no end"),
        ("snr where=near < 12", "unknown key 'where', expected one of measure, view, scale, lod, method"),
        ("snr lod=near < 12", "the lod 'near' is not a number"),
        ("psnr near < 12", "there is no figure 'psnr', expected measure snr, flicker, flip"),
        ("scale=snr near < 12", "there is no scale 'snr', expected scale near, 1:1, middle, far"),
        ("snr near-mirror lod=6 < 1", "there is no lod '6', expected lod 0, 0.25, 0.5"),
        ("snr near-mirror near over lean < 1", "was not measured for method 'lean', but for neural, linear (box)"),
        ("snr near-mirror < 1", "it does not say which scale, expected one of near, 1:1, middle, far"),
        ("flip near hemisphere < 1", "flip near was not measured for view 'hemisphere', but for sphere"),
        ("flip sphere middle < 1", "flip sphere was not measured for scale 'middle', but for near, far"),
    ],
)
def test_what_is_no_condition_is_refused_with_an_example(text: str, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse(text).check(comparison())
    assert said in str(refused.value)
    assert repr(text) in str(refused.value) and EXAMPLE in str(refused.value) and "\n" not in str(refused.value)


def test_best_is_a_closed_form_other_than_the_subject() -> None:
    found = comparison("lean (blackman-harris)")
    assert parse("snr near-mirror lod=0 over best < 0").check(found).value == pytest.approx(1)
    alone = replace(found, subject="neural", methods=found.methods[:1])
    with pytest.raises(UsageError, match="no closed form is compared"):
        parse("snr near-mirror lod=0 over best < 1").check(alone)


def test_every_example_of_the_help_text_parses() -> None:
    examples = GRAMMAR.split("Examples:")[1].split("'")[1::2]
    assert len(examples) == 3 and EXAMPLE in examples
    for text in examples:
        parse(text)


PIECES = st.sampled_from(
    ["near-mirror", "hemisphere", "flip", "snr", "lod=", "0", "0.25", "1:1", "far", "over", "=", "'", "'linear (box)'",
     "best", "<", "<=", ">", ">=", " ", "12", "1e5", "\\", "plane", "\n", "\0", "٣", "é"]
)  # fmt: skip


@given(st.one_of(st.text(max_size=60), st.lists(PIECES, max_size=12).map(" ".join)))
@example("snr near-mirror lod=0<" + "1" * 10_000)
@example("snr near-mirror near < ٣")
def test_no_text_does_anything_but_parse_or_be_refused(text: str) -> None:
    try:
        condition = parse(text)
        outcome = condition.check(comparison())
    except UsageError as error:
        assert repr(text) in error.full
        return
    assert isinstance(condition, Condition) and math.isfinite(condition.number)
    assert isinstance(outcome.failed, bool)
