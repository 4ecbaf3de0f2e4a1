"""What errors count: every weight of what is better, in one place.

Stacks are compared by terms, each the logarithm of an error relative to the signal at a level of detail. What a stack
is worth there is the sum of its terms, each times what it `counts`. What is behind what is asked for, the best closed
form, counts `behind` times in addition, so that no gain in one term is paid for by a loss in another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.pairs import PAIR_SETS

Array = NDArray[np.float64]

BRIGHT = ("grazing", "highlights")
"""Kinds of groups of bright pairs (pairs.py). Near the mirror, views graze in the first kind, and not in the
second; over the hemisphere both kinds are drawn alike."""

SEEN = "seen, facing", "seen, slanted"
"""The terms of what people see: the visible error of small pictures that face the viewer, and of slanted ones
(mipbake.quality.small_pictures)."""

TERMS = (*PAIR_SETS, *(f"{kind}, {name}" for kind in BRIGHT for name in PAIR_SETS), *SEEN)
"""Names of the terms, in the order that scores have them."""


@dataclass(frozen=True)
class Weight:
    """What a term counts.

    Args:
        counts: a neper of its error. behind: a neper by which it is behind what is asked for, in addition.
    """

    counts: float
    behind: float


@dataclass(frozen=True)
class Weights:
    """What all terms count at one level of detail.

    Args:
        terms: name to weight, every name of TERMS.
        group_behind: what a neper counts by which a group of pairs is behind the best rule of engines and tools in that
            very group, in the mean over groups: another rule may be the best there than in the mean over groups.
        chance: standard errors by which a row of errors may be behind.
        tie: nepers below which two errors measure the same. seen_tie: the same, of what is seen.
        group_tie: nepers by which groups may be behind in the mean over them before a level gives way.
        looks_worse: nepers of a term of what is seen by which a closed form may be behind the best ingredient, and its
            SNR is still asked for.

    The ties are guesses, too.
    """

    terms: Mapping[str, Weight]
    group_behind: float
    chance: float = 0.5
    tie: float = 0.01
    seen_tie: float = 0.04
    group_tie: float = 0.02
    looks_worse: float = math.inf

    def __post_init__(self) -> None:
        if tuple(self.terms) != TERMS:
            raise AssertionError(f"weights of {', '.join(self.terms)}: expected the names {', '.join(TERMS)}")

    @property
    def counts(self) -> Array:
        """(T,) what every term counts."""
        return np.array([each.counts for each in self.terms.values()])

    @property
    def behind(self) -> Array:
        """(T,) what every term counts in addition while it is behind."""
        return np.array([each.behind for each in self.terms.values()])


_BEHIND = {
    "near-mirror": 30.0,
    "hemisphere": 30.0,
    "grazing, near-mirror": 10.0,
    "grazing, hemisphere": 3.0,
    "highlights, near-mirror": 10.0,
    "highlights, hemisphere": 3.0,
}
"""What a neper counts, in addition, by which a term of pairs is behind the best closed form. What falls behind where
one bright pair rules a set of pairs counts most."""

_PAIRS = 0.04  # what a term of pairs counts at an aim of 1, where it is 1 at an aim of 0
_SEEN = 0.4, 2.2  # what a term of what is seen counts at an aim of 0, and more at an aim of 1
_SEEN_BEHIND = 40.0  # at an aim of 1, and less in proportion to its square
_GROUPS = 6.0  # at an aim of 0
_TIE, _GIVES_WAY = 0.01, 0.3  # nepers by which a term of pairs may be behind, and how many more at an aim of 1
_EASED = 2.0  # aim from 0.5 on by which the terms of pairs may be behind
_LOOKS_WORSE = 0.25  # nepers by which forms may look worse at an aim of 1, as 0.5 was tried at one of 0.5
_LEAST_BEHIND = 0.02  # share of what being behind counts at an aim of 1


def weights_for(aim: float) -> Weights:
    """What everybody counts who asks which of two stacks is better.

    Up to an aim of 1/2 no term of pairs may be behind the best closed form that looks fine; from there on they give
    way. The greater the aim, the better a closed form has to look for its SNR to be asked for; at an aim of 0 the SNR
    of all of them is.

    Args:
        aim: from 0, single lights, to 1, what people see.
    """
    counts = _PAIRS**aim
    eased = min(1.0, max(_LEAST_BEHIND, _EASED - _EASED * aim))
    pairs = {name: Weight(counts, eased * behind) for name, behind in _BEHIND.items()}
    seen = {name: Weight(_SEEN[0] + _SEEN[1] * aim, _SEEN_BEHIND * aim**2) for name in SEEN}
    return Weights(
        pairs | seen,
        group_behind=_GROUPS * eased * (1 - aim),
        tie=_TIE + _GIVES_WAY * aim,
        looks_worse=_LOOKS_WORSE / aim if aim else math.inf,
    )


SINGLE_LIGHTS = Weights(
    {
        "near-mirror": Weight(1.0, 10.0),
        "hemisphere": Weight(1.0, 10.0),
        "grazing, near-mirror": Weight(0.5, 0.0),
        "grazing, hemisphere": Weight(0.5, 0.0),
        "highlights, near-mirror": Weight(0.5, 0.0),
        "highlights, hemisphere": Weight(0.5, 0.0),
        SEEN[0]: Weight(0.0, 0.0),
        SEEN[1]: Weight(0.0, 0.0),
    },
    group_behind=0.0,
)
"""What the optimum counts, which is a limit of SNR: both pair sets, and nothing that people look at. Bright pairs count
in addition, because few of the pairs of a descent are bright, and bright ones rule the errors."""
