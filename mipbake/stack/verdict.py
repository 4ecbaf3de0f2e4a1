"""The verdict of a bake: how its stack looks beside plain MIP maps, distance by distance, in words for artists.

These are all words of verdicts. A bake has them from small pictures (`verdict`), and the page of a report from films
(mipbake.comparing.page.verdict).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from mipbake.stack.measured import Measured

Distance = Literal["near", "middle", "far"]

DISTANCES: tuple[Distance, ...] = get_args(Distance)
"""Where a surface is seen: at levels of detail below 1, from 1 to 3, and from 3 on."""

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


def verdict(measured: Measured) -> Verdict:
    """What was measured of a stack, in words."""
    effect: Effect = 0
    if measured.visible is not None and not measured.looks_plain:
        effect = 1 if measured.visible < 1 else -1
    return in_words(dict.fromkeys(DISTANCES, effect))


def in_words(effects: Mapping[Distance, Effect]) -> Verdict:
    """The verdict on a stack that has these effects, at some of the distances."""
    found = set(effects.values())
    gains, loses = 1 in found, -1 in found
    outcome: Outcome = "mixed" if gains and loses else "gains" if gains else "loses" if loses else "same"
    parts = {
        "calmer and truer to the source": _where(effects, 1),
        "no visible gain": _where(effects, 0),
        "worse than plain MIP maps": _where(effects, -1),
    }
    sentence = "; ".join(f"{words} {where}" for words, where in parts.items() if where)
    return Verdict(outcome, f"{sentence[:1].upper()}{sentence[1:]}.", _ADVICE[outcome])


_PLACES: Mapping[Distance, str] = {"near": "near", "middle": "at middle distance", "far": "far away"}

_ADVICE: Mapping[Outcome, str] = {
    "gains": "Recommended.",
    "same": f"Plain MIP maps look the same on this set: {PLAIN_OPTIONS} writes them.",
    "mixed": "Try --method neural, and see both with mipbake compare.",
    "loses": f"Plain MIP maps look better on this set: {PLAIN_OPTIONS} writes them.",
}


def _where(effects: Mapping[Distance, Effect], effect: Effect) -> str:
    """`from middle distance on`: where an effect is seen; empty for nowhere."""
    places = [distance for distance in DISTANCES if effects.get(distance) == effect]
    if places and len(places) == len(effects):
        return f"at {'every' if effect else 'any'} distance"
    if places == ["middle", "far"]:
        return "from middle distance on"
    return " and ".join(_PLACES[each] for each in places)
