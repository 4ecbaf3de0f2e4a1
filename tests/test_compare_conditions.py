"""Conditions for build pipelines: what they mean, and that no text does anything but mean something or be refused."""

from __future__ import annotations

import math
import operator

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


def comparison(subject: str = "neural", rendered: str = "sphere") -> Comparison:
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
        figures += [of(name, "flip", rendered, scale, flip[name]) for scale in ("near", "far")]
        figures += [of(name, "tonemapped", rendered, "near", flip[name] / 2), of(name, "flip", "plane", "", 0.5)]
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
        ("near_mirror@0 < 12", False, 12),
        ("near_mirror@0 <= 12", True, 12),
        ("near_mirror@0 >= 12", True, 12),
        ("near_mirror@0 > 12", False, 12),
        ("  NEAR-mirror @ 0.50<1.2e1  ", True, 11.5),
        ("near_mirror@.25 < -3.5", False, 11.75),
        ("hemisphere@1:1 < 33", True, 32),
        ("near_mirror@near > 11", True, 12),
        ("snr@middle < +9", False, 9),
        ("hemisphere.snr@middle < 30", True, 29),
        ("linear (box):near_mirror@0 < 11", True, 10),
        (" Linear  (BOX) : near_mirror@0 < 11", True, 10),
        ("lean (blackman_harris):near_mirror@0 < 11.5", True, 11),
        ("near_mirror@0 - linear (box) < 1", False, 2),
        ("near_mirror@0-lean (blackman-harris) < 2", True, 1),
        ("near_mirror@0 - best < 1", False, 1),
        ("optimum:near_mirror@0 - neural > 7", True, 8),
        ("best:near_mirror@0 < 11", False, 11),
        ("flip@near > 0.05", True, 0.1),
        ("best:flip@near > 0.1", True, 0.2),
        ("flip@near - best > 0", False, -0.1),
        ("plane.flip < 0.6", True, 0.5),
        ("plane.flip - best > 0", False, 0),
        ("neural:plane.flip - linear (box) > 0", False, 0),
        ("flicker@near > 1.4", True, 1.5),
        ("hemisphere.flicker@near > 4", False, 3),
        ("best:flicker@near < 1", True, 0.5),  # 3 is further from 1 than 1/2 is
        ("sphere.tonemapped@near < 0.06", True, 0.05),
        ("film_floor.jod_37 < 9", False, 9.5),
        ("FILM-floor.JOD-37 - best < 0", False, 0.5),  # 9.5 and LEAN's 9, the better of two
        ("linear (box):film_floor.jod_37 < 9", True, 8.5),
        ("film_floor.snr < 10", True, 9),
    ],
)
def test_conditions_mean_what_they_say(text: str, failed: bool, value: float) -> None:
    condition = parse(text)
    found = comparison()
    outcome = condition.check(found)
    assert outcome.value == pytest.approx(value)
    assert outcome.failed == failed
    assert ("does not hold" in outcome.sentence) != failed
    assert repr(text) in outcome.sentence


def test_sentences_say_whose_figure_it_is() -> None:
    said = parse("near_mirror@0.25 - linear (box) < 1").check(comparison()).sentence
    assert "SNR of neural (near-mirror, lod 0.25) is 11.75 dB (95 % interval 10.75 to 12.75)" in said
    assert "and linear (box) has 9.75 dB" in said
    assert "the difference is 2" in said
    assert "FLIP of neural (plane) is 0.5" in parse("plane.flip > 1").check(comparison()).sentence
    assert "Flicker of neural (near-mirror, 1:1) is 1.5" in parse("flicker@1:1 > 1").check(comparison()).sentence


def test_the_subject_is_no_rival_of_its_own() -> None:
    assert parse("near_mirror@0 - best < 0").check(comparison("lean (blackman-harris)")).value == pytest.approx(1)


def test_renders_of_another_mesh_take_the_place_of_spheres() -> None:
    assert parse("flip@near > 0").check(comparison(rendered="mesh")).value == pytest.approx(0.1)


@pytest.mark.parametrize("op", ["<", "<=", ">", ">="])
def test_what_is_not_a_number_fails_the_build(op: str) -> None:
    for text in (f"hemisphere.flicker@far {op} 1", f"hemisphere.flicker@far - best {op} 1"):
        outcome = parse(text).check(comparison())
        assert outcome.failed
        assert math.isnan(outcome.value)
        assert "cannot be decided, which counts as failed" in outcome.sentence
        assert "is nan" in outcome.sentence


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "at character 1: nothing follows to compare with"),
        ("near_mirror@0", "at character 14: nothing follows to compare with"),
        ("near_mirror@0 = 12", "nothing follows to compare with"),
        ("near_mirror@0 < ", "'' is not a number"),
        ("near_mirror@0 < 12 dB", "at character 16: '12 dB' is not a number"),
        ("near_mirror@0 < nan", "'nan' is not a number"),
        ("near_mirror@0 < 1e999", "'1e999' is not a number"),
        ("near_mirror@0 < 1 < 2", "'1 < 2' is not a number"),
        ("near_mirror@0 << 1", "'< 1' is not a number"),
        (
            "near_miror@0 < 12",
            "at character 1: 'near_miror' is not a quantity, expected one of near_mirror, hemisphere, snr",
        ),
        ("neural:psnr@0 < 12", "at character 8: 'psnr' is not a quantity"),
        (".flip@near < 1", "'.flip' is not a quantity"),
        ("sphere.near_mirror@near < 1", "'sphere.near_mirror' is not a quantity"),
        ("@0 < 12", "'' is not a quantity"),
        (":near_mirror@0 < 12", "at character 1: a method is missing before the colon"),
        ("near_mirror@0 - < 12", "at character 16: a method is missing behind the minus"),
        ("near_mirror < 12", "at character 13: it does not say where"),
        ("flip < 12", "at character 6: it does not say where"),
        ("jod_37 < 9", "at character 1: it does not say of which film, expected it before, film_floor.jod_37"),
        ("jod_37@near < 9", "at character 1: it does not say of which film"),
        ("film_floor.jod < 9", "'film_floor.jod' is not a quantity"),
        ("hemisphere.flicker < 12", "it does not say where"),
        ("near_mirror@ < 12", "'' is not a place"),
        ("near_mirror@close < 12", "at character 13: 'close' is not a place, expected near, 1:1, middle, far"),
        ("near_mirror@-1 < 12", "is not a place"),
        ("near_mirror@inf < 12", "is not a place"),
        ("flip@0 < 1", "at character 6: flip has no curve over levels of detail, expected near, 1:1, middle, far"),
        ("flicker@0.25 < 1", "flicker has no curve"),
        ("sphere.snr@0 < 1", "snr has no curve"),
        ("near_mirror.flip@near < 1", "flip is measured on renders, not for near-mirror"),
        ("near_mirror@0@1 < 1", "expected [METHOD:]QUANTITY"),
        ("a:b:near_mirror@0 < 1", "expected [METHOD:]QUANTITY"),
    ],
)
def test_broken_conditions_are_refused_with_where_and_an_example(text: str, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse(text)
    assert said in str(refused.value)
    assert repr(text) in str(refused.value)
    assert EXAMPLE in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "filament (box):near_mirror@0 < 1",
            "no method 'filament (box)' is compared, expected best or one of neural, lin",
        ),
        ("near_mirror@0 - lean < 1", "no method 'lean' is compared"),
        (
            "near_mirror@6 < 1",
            "no SNR is measured at lod 6, but at 0, 0.25, 0.5; or name a scale, near, 1:1, middle, far",
        ),
    ],
)
def test_what_is_not_compared_is_said(text: str, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse(text).check(comparison())
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hemisphere@0 < 1", "snr of neural was not measured for hemisphere, but for near-mirror"),
        ("ssim@near < 1", "ssim of neural was not measured for sphere, but for nothing"),
        ("mesh.flip@near < 1", "flip of neural was not measured for mesh, but for sphere, plane"),
        ("film_wall.jod_37 < 9", "jod-37 of neural was not measured for film-wall, but for film-floor"),
        ("film_floor.jod_75 < 9", "jod-75 of neural was not measured for film-floor, but for nothing"),
        ("flip@middle < 1", "flip for sphere was not measured at middle, but at near, far"),
        (
            "plane.flip@near < 1",
            "flip for plane was not measured at near, but over all scales at once: leave the place",
        ),
        ("sphere.flip < 1", "flip for sphere was not measured without a scale, but at near, far"),
    ],
)
def test_what_was_not_measured_is_said_with_what_was(text: str, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse(text).check(comparison())
    assert said in str(refused.value)


def test_best_needs_a_closed_form() -> None:
    found = comparison("linear (box)")
    alone = Comparison("set", "neural", "gltf", "gaussian", (found.methods[0],), found.curve, found.figures)
    with pytest.raises(UsageError, match="no closed form is compared"):
        parse("near_mirror@0 - best < 1").check(alone)


def test_every_example_of_the_help_text_parses() -> None:
    examples = GRAMMAR.split("Examples:")[1].split("'")[1::2]
    assert len(examples) == 4
    for text in (EXAMPLE, *examples):
        assert parse(text).text == text


PIECES = st.sampled_from(
    ["near_mirror", "hemisphere", "flip", "snr", "@", "0", "0.25", "1:1", "far", "-", " - ", ":", ".", "linear (box)",
     "best", "<", "<=", ">", ">=", " ", "12", "1e5", "_", "plane", "\n", "\0", "٣", "é"]
)  # fmt: skip


@given(st.one_of(st.text(max_size=60), st.lists(PIECES, max_size=12).map("".join)))
@example("near_mirror@0<" + "1" * 10_000)
@example(" " * 5_000)
@example("a:" * 5_000)
@example("near_mirror@0 < ٣")
def test_no_text_does_anything_but_parse_or_be_refused(text: str) -> None:
    try:
        condition = parse(text)
    except UsageError as error:
        assert repr(text) in error.full
        return
    assert isinstance(condition, Condition)
    assert math.isfinite(condition.number)
    try:
        outcome = condition.check(comparison())
    except UsageError:
        return
    assert isinstance(outcome.failed, bool)


@given(
    st.sampled_from([None, "best", *METHODS]),
    st.sampled_from(["near_mirror", "hemisphere", "flicker"]),
    st.sampled_from(list(SCALES)),
    st.sampled_from([None, "best", *METHODS]),
    st.sampled_from(["<", "<=", ">", ">="]),
    st.floats(-50, 50),
    st.sampled_from(["", " ", "  "]),
)
def test_what_is_written_is_what_is_read(
    method: str | None, quantity: str, where: str, other: str | None, op: str, number: float, space: str
) -> None:
    whose, less = f"{method}:" if method else "", f" - {other}" if other else ""
    text = f"{whose}{quantity}@{where}{less}{space}{op}{space}{number!r}"
    condition = parse(text)
    assert (condition.method, condition.where, condition.other) == (method, where, other)
    assert (condition.comparison, condition.number) == (op, number)
    outcome = condition.check(comparison())
    compared = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}[op]
    assert outcome.failed == (math.isnan(outcome.value) or compared(outcome.value, number))
