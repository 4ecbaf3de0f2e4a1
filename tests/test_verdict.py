"""The verdict of a bake, in words: what small pictures show at which distance, and what to do."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest

from mipbake.stack.measured import Looks, Measured, MeasuredLevel, measured_from
from mipbake.stack.verdict import DISTANCES, PLAIN_OPTIONS, Distance, Effect, distance_of, in_words, verdict


def effects(near: Effect, middle: Effect, far: Effect) -> dict[Distance, Effect]:
    return dict(zip(DISTANCES, (near, middle, far), strict=True))


@pytest.mark.parametrize(
    ("found", "outcome", "sentence"),
    [
        ((1, 1, 1), "gains", "Calmer and truer to the source at every distance."),
        ((0, 1, 1), "gains", "Calmer and truer to the source from middle distance on; no visible gain near."),
        ((0, 0, 1), "gains", "Calmer and truer to the source far away; no visible gain near or at middle distance."),
        ((0, 0, 0), "same", "No visible gain at any distance."),
        ((-1, 0, 1), "mixed", "Calmer and truer to the source far away; no visible gain at middle distance; worse"),
        ((0, -1, -1), "loses", "No visible gain near; worse than plain MIP maps from middle distance on."),
    ],
)
def test_words_say_where(found: tuple[Effect, Effect, Effect], outcome: str, sentence: str) -> None:
    said = in_words(effects(*found))
    assert said.outcome == outcome and said.sentence.startswith(sentence)
    assert str(said) == f"{said.sentence} {said.advice}"
    assert (PLAIN_OPTIONS in said.advice) == (outcome in ("same", "loses"))
    assert (said.advice == "Recommended.") == (outcome == "gains")


def test_advice_says_what_to_type() -> None:
    assert "--keep-level0" in in_words(effects(-1, 1, 1)).advice and "--aim 1" in in_words(effects(1, 1, -1)).advice
    better = "--method neural"
    for found in ((0, 0, 0), (0, 0, -1), (1, 0, -1)):
        assert better in in_words(effects(*found), better).advice
    assert in_words(effects(0, 1, 1), better).advice == "Recommended."


def test_words_of_some_distances() -> None:
    assert in_words({"far": 1}).sentence == "Calmer and truer to the source far away."
    assert in_words({"near": 0, "far": 0}).sentence == "No visible gain near or far away."
    assert [distance_of(lod) for lod in (0.0, 0.99, 1.0, 3.0, 3.1, 9.0)] == [
        "near", "near", "middle", "middle", "far", "far",
    ]  # fmt: skip


def measured(*looks: tuple[float, float, float]) -> Measured:
    """Levels by the visible error of plain MIP maps, that of the stack as a share, and dB above plain MIP maps."""
    figures = ({"near-mirror": 10.0}, {"near-mirror": 0.1}, {"near-mirror": "lean (box)"}, {"near-mirror": 9.0})
    levels = []
    for level, (plain, share, gain) in enumerate(looks):
        found = Looks(plain * share, plain, 0.01, {"near-mirror": gain})
        levels.append(MeasuredLevel(*figures, {"near-mirror": 0.1}, level, ("neural",), 0.0, found))
    return Measured(tuple(levels), 8, 8, 0.5)


SAME, CALMER, WORSE = (0.1, 1.0, 0.0), (0.1, 0.9, 8.0), (0.1, 1.3, -1.0)
INVISIBLE, MAGNIFIED = (0.032, 0.95, 12.0), (0.1, 1.3, 0.5)


@pytest.mark.parametrize(
    ("near", "middle", "far", "expected"),
    [
        (SAME, SAME, SAME, (0, 0, 0)),
        (CALMER, CALMER, CALMER, (1, 1, 1)),
        (INVISIBLE, INVISIBLE, INVISIBLE, (0, 0, 0)),
        ((0.1, 1.0, 2.0), (0.1, 1.0, 2.0), (0.1, 1.0, 2.0), (0, 0, 1)),
        (WORSE, SAME, SAME, (-1, 0, 0)),
        (SAME, SAME, WORSE, (0, 0, -1)),
        (MAGNIFIED, SAME, CALMER, (0, 0, 1)),  # texels larger than pixels, which films do not show
    ],
)
def test_single_lights_and_small_pictures_say_how_every_distance_looks(near, middle, far, expected):
    found = verdict(measured(near, middle, middle, far, far, far, WORSE, WORSE))
    assert found == in_words(effects(*expected))  # the coarsest levels are seen near the horizon alone


def test_a_stack_that_looks_worse_in_small_pictures_gains_nowhere() -> None:
    """Waves that glint are calmer under single lights, and darker than they should be in films."""
    found = measured(SAME, MAGNIFIED, MAGNIFIED, CALMER, CALMER, CALMER)
    assert verdict(replace(found, visible=1.07)) == in_words(effects(0, -1, 0))
    assert verdict(replace(found, visible=1.02)) == in_words(effects(0, 0, 1))
    assert verdict(replace(found, visible=0.0)) == in_words(effects(0, 0, 1))  # a file may hold anything


def test_stacks_of_few_levels_say_nothing_of_far_away() -> None:
    assert verdict(measured(SAME, CALMER)) == in_words({"near": 0, "middle": 1})


@pytest.mark.parametrize(("visible", "outcome"), [(0.7, "gains"), (0.99, "same"), (1.2, "same"), (None, "same")])
def test_stacks_of_earlier_versions_have_a_verdict(visible: float | None, outcome: str) -> None:
    assert verdict(Measured((), 8, 8, visible)).outcome == outcome


def test_what_was_measured_is_read_back_and_old_stacks_have_no_looks() -> None:
    figures = ({"sharp": 10.0}, {"sharp": 0.1}, {"sharp": "lean (box)"}, {"sharp": 9.0}, {"sharp": 0.1})
    level = MeasuredLevel(*figures, 0, ("neural",), 0.0, Looks(0.05, 0.06, 0.01, {"sharp": 2.0}))
    found = Measured((level, replace(level, level=1)), 8, 8, 0.9)
    content = json.loads(json.dumps(asdict(found)))
    assert measured_from(content) == found
    for each in content["levels"]:
        del each["looks"]
    old = measured_from(content)
    assert old is not None and {each.looks for each in old.levels} == {None} and old.visible == 0.9
    content["levels"][0]["looks"] = {"own": 0.0, "plain": 0.1, "error": 0.1, "snr_gain": {}}
    with pytest.raises(ValueError, match="expected more than 0"):
        measured_from(content)
