"""The verdict of a bake: how its stack looks beside plain MIP maps, distance by distance, in words for artists.

These are all words of verdicts. A bake has them from small pictures (`verdict`), and the page of a report from films
(mipbake.comparing.page.verdict).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Literal, get_args

from mipbake.quality.metrics.visible import UNSEEN
from mipbake.stack.measured import Looks, Measured

Distance = Literal["near", "middle", "far"]

DISTANCES: tuple[Distance, ...] = get_args(Distance)
"""Where a surface is seen: at levels of detail below 1, from 1 to 3, and above 3."""

Effect = Literal[1, 0, -1]
"""Of a stack at a distance, beside plain MIP maps: it looks better, the same or worse."""

Outcome = Literal["gains", "same", "mixed", "loses"]

PLAIN_OPTIONS = "--method linear --filter box"
"""What writes plain MIP maps."""


@dataclass(frozen=True)
class Verdict:
    """The verdict, in words without figures.

    Args:
        outcome: at all distances together; `mixed` where a stack gains at one distance and loses at another.
        sentence: where it looks better, the same and worse.
        advice: what to do.
    """

    outcome: Outcome
    sentence: str
    advice: str

    def __str__(self) -> str:
        """Both."""
        return f"{self.sentence} {self.advice}"


_MIDDLE, _FAR = 1.0, 3.0  # levels of detail from which a surface is at middle distance, and above which it is far away


def distance_of(lod: float) -> Distance:
    """The distance at which a level of detail is seen."""
    lod = round(lod, 6)
    return "near" if lod < _MIDDLE else "middle" if lod <= _FAR else "far"


_LEVELS: Mapping[Distance, Sequence[int]] = {"near": (0,), "middle": (1, 2), "far": (3, 4, 5)}
"""Levels that say how a distance looks; coarser ones are seen only near the horizon."""

_SEEN: Mapping[Distance, float] = {"near": 0.2, "middle": 0.5, "far": 0.1}
"""dB that stacks are above plain MIP maps near the mirror, times what is seen of the error of these, from which films
look better by 0.1 JOD. Found on floors of 20 sets for training, of which 17 are on the right side; near and at middle
distance on films of seven."""

_MIRROR = "near-mirror"  # pair set
_LOST = -0.04  # nepers of the visible error: small pictures with fewer look alike, as the judge has it
_SURE = 2.0  # standard errors


def verdict(measured: Measured) -> Verdict:
    """What was measured of a stack, in words."""
    effects: dict[Distance, Effect] = {}
    visible = measured.visible
    worse = visible is not None and visible > math.exp(-_LOST)
    for distance, levels in _LEVELS.items():
        found = [each.looks for each in measured.levels if each.level in levels and each.looks is not None]
        if found:
            effects[distance] = _effect(found, distance, worse)
    if not effects:  # stacks of versions that measured one figure
        effects = dict.fromkeys(DISTANCES, 1 if visible is not None and not measured.looks_plain else 0)
    return in_words(effects)


def _effect(found: Sequence[Looks], distance: Distance, worse: bool) -> Effect:
    """Of the levels of a distance together. `worse`: whether small pictures of the whole stack look worse, which then
    gains nowhere.

    Still pictures hardly show what shimmers, and films do. So how much cleaner renders are under single lights counts
    times how much of the error of plain MIP maps can be seen at all.
    """
    decibels = [each.snr_gain.get(_MIRROR, 0.0) for each in found]
    seen = [math.sqrt(max(0.0, each.plain**2 - UNSEEN)) for each in found]
    if not worse and fmean(gain * error for gain, error in zip(decibels, seen, strict=True)) >= _SEEN[distance]:
        return 1
    visible = fmean(math.log(each.plain / each.own) for each in found)
    error = math.sqrt(sum(each.error**2 for each in found)) / len(found)
    # Small pictures also show texels larger than pixels, which films do not: something else has to agree to a loss.
    return -1 if visible < min(_LOST, -_SURE * error) and (worse or fmean(decibels) < 0) else 0


def in_words(effects: Mapping[Distance, Effect], better: str = "") -> Verdict:
    """The verdict on a stack that has these effects, at some of the distances. `better`: options of a bake that is
    known to look better than plain MIP maps; "" for none."""
    gains, loses = (effect in effects.values() for effect in (1, -1))
    outcome: Outcome = "mixed" if gains and loses else "gains" if gains else "loses" if loses else "same"
    parts = [f"{words} {where}" for effect, words in _WORDS.items() if (where := _where(effects, effect))]
    sentence = "; ".join(parts)
    return Verdict(outcome, f"{sentence[:1].upper()}{sentence[1:]}.", _advice(effects, outcome, better))


_WORDS: Mapping[Effect, str] = {
    1: "calmer and truer to the source",
    0: "no visible gain",
    -1: "worse than plain MIP maps",
}
_PLACES: Mapping[Distance, str] = {"near": "near", "middle": "at middle distance", "far": "far away"}


def _where(effects: Mapping[Distance, Effect], effect: Effect) -> str:
    """`from middle distance on`: where an effect is seen; empty for nowhere."""
    places = [distance for distance in DISTANCES if effects.get(distance) == effect]
    if len(places) == len(DISTANCES):
        return f"at {'every' if effect else 'any'} distance"
    if places == ["middle", "far"]:
        return "from middle distance on"
    return (" or " if effect == 0 else " and ").join(_PLACES[each] for each in places)


def _advice(effects: Mapping[Distance, Effect], outcome: Outcome, better: str) -> str:
    if outcome == "gains":
        return "Recommended."
    if outcome == "same":
        said = f"Plain MIP maps look the same on this set: {PLAIN_OPTIONS} writes them."
        return f"{said} {better} looks better." if better else said
    if better:
        return f"Try {better}, which looks better than plain MIP maps."
    if outcome == "loses":
        return f"Plain MIP maps look better on this set: {PLAIN_OPTIONS} writes them."
    if [distance for distance, effect in effects.items() if effect == -1] == ["near"]:
        return "Recommended with --keep-level0, which leaves the finest level as it is."
    return "Try --aim 1, which counts what is seen alone."
