"""The verdict of a bake, in words: what small pictures show at which distance, and what to do."""

from __future__ import annotations

import pytest

from mipbake.stack.measured import Measured
from mipbake.stack.verdict import DISTANCES, PLAIN_OPTIONS, Distance, Effect, distance_of, in_words, verdict


def effects(near: Effect, middle: Effect, far: Effect) -> dict[Distance, Effect]:
    return dict(zip(DISTANCES, (near, middle, far), strict=True))


@pytest.mark.parametrize(
    ("found", "outcome", "sentence"),
    [
        ((1, 1, 1), "gains", "Calmer and truer to the source at every distance."),
        ((0, 1, 1), "gains", "Calmer and truer to the source from middle distance on; no visible gain near."),
        (
            (0, 0, 1),
            "gains",
            "Calmer and truer to the source far away; no visible gain near or at middle distance.",
        ),
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


@pytest.mark.parametrize(("visible", "outcome"), [(0.7, "gains"), (0.99, "same"), (1.2, "same"), (None, "same")])
def test_stacks_of_earlier_versions_have_a_verdict(visible: float | None, outcome: str) -> None:
    assert verdict(Measured((), 8, 8, visible)).outcome == outcome
