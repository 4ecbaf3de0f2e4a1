"""The terms of the judge: what errors it counts, where a score has them, and what they weigh at which aim.

A term reads one row of an array of a `Score`. Its value is the mean of the row, which is the logarithm of an error
relative to the signal. Every row has its term, so a new term is an entry of TERMS and a new row: one more kind of small
picture, or a new array of `Score` and of `Slopes` (judge.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.pairs import PAIR_SETS

Array = NDArray[np.float64]

LOG_ERRORS, POOLED, VISIBLE = "log_errors", "pooled", "visible"
"""Arrays of a `Score`: of groups of pairs, of bright pairs, and of small pictures."""

ARRAYS = LOG_ERRORS, POOLED, VISIBLE
"""All of them, in the order of TERMS."""

_UNSURE = 0.35  # standard error of a logarithm


@dataclass(frozen=True)
class Weight:
    """What a term counts.

    Args:
        counts: a neper of its error. behind: a neper by which it is behind the baseline, in addition.
        tie: nepers below which two errors measure the same; a guess.
    """

    counts: float
    behind: float
    tie: float = 0.01


@dataclass(frozen=True)
class Term:
    """An error that the judge counts.

    Args:
        name: as pages and records have it. array, row: which row of a `Score` it reads.
        weight: aim, from 0 to 1, to what it counts. single_lights: what it counts where SNR alone counts.
    """

    name: str
    array: str
    row: int
    weight: Callable[[float], Weight]
    single_lights: Weight

    @property
    def visible(self) -> bool:
        """Whether it is about what people see, and not about single lights."""
        return self.array == VISIBLE

    def values(self, score: object) -> Array:
        """(N,) values of a `Score`, whose mean is the value, and whose scatter says how sure that is."""
        return np.asarray(getattr(score, self.array)[self.row])

    def value(self, score: object) -> float:
        """The logarithm of the error."""
        return float(self.values(score).mean())


def certainty(rows: Array) -> Array:
    """(...,) of rows (..., H) of pseudo-values: 1 for a mean that is known, 1/2 where its standard error is _UNSURE.

    Highlights of polished tiles are seen by one pair in thousands, and the few bright pairs that hit them say anything.
    """
    return np.asarray(1 / (1 + np.square(standard_error(rows) / _UNSURE)))


def standard_error(values: Array) -> Array:
    """Standard errors of means over the last axis."""
    return np.asarray(values.std(-1) / math.sqrt(max(1, values.shape[-1] - 1)))


_PAIRS = 0.04  # what a term of pairs counts at an aim of 1, where it is 1 at an aim of 0
_SEEN = 0.4, 2.2  # what a term of pictures counts at an aim of 0, and more at an aim of 1
_SEEN_BEHIND = 40.0  # at an aim of 1, and less in proportion to its square
_TIE, _GIVES_WAY = 0.01, 0.3  # nepers by which a term of pairs may be behind, and how many more at an aim of 1
_SEEN_TIE = 0.04
_EASED = 2.0  # aim from 0.5 on by which the terms of pairs may be behind
_LEAST_BEHIND = 0.02  # share of what being behind counts at an aim of 1
_GROUPS = 6.0  # at an aim of 0
_LOOKS_WORSE = 0.25  # nepers by which forms may look worse at an aim of 1, as 0.5 was tried at one of 0.5


def eased(aim: float) -> float:
    """Share of what terms of pairs that are behind count at an aim."""
    return min(1.0, max(_LEAST_BEHIND, _EASED - _EASED * aim))


def _of_pairs(behind: float, aim: float) -> Weight:
    return Weight(_PAIRS**aim, eased(aim) * behind, _TIE + _GIVES_WAY * aim)


def _of_pictures(aim: float) -> Weight:
    return Weight(_SEEN[0] + _SEEN[1] * aim, _SEEN_BEHIND * aim**2, _SEEN_TIE)


# What a neper counts, in addition, by which a term of pairs is behind the best closed form. What falls behind where one
# bright pair rules a set of pairs counts most.
_BEHIND = {"near-mirror": 30.0, "hemisphere": 30.0}
_BRIGHT_BEHIND = {"near-mirror": 10.0, "hemisphere": 3.0}

# Kinds of groups of bright pairs (pairs.py). Near the mirror, views graze in the first kind, and not in the second;
# over the hemisphere both kinds are drawn alike.
_BRIGHT = "grazing", "highlights"
_SETS = tuple(PAIR_SETS)

TERMS: Mapping[str, Term] = {
    term.name: term
    for term in (
        *(
            Term(name, LOG_ERRORS, row, partial(_of_pairs, _BEHIND[name]), Weight(1.0, 10.0))
            for row, name in enumerate(_SETS)
        ),
        *(
            Term(f"{kind}, {name}", POOLED, row, partial(_of_pairs, _BRIGHT_BEHIND[name]), Weight(0.5, 0.0))
            for row, (kind, name) in enumerate((kind, name) for kind in _BRIGHT for name in _SETS)
        ),
        Term("seen, facing", VISIBLE, 0, _of_pictures, Weight(0.0, 0.0, _SEEN_TIE)),
        Term("seen, slanted", VISIBLE, 1, _of_pictures, Weight(0.0, 0.0, _SEEN_TIE)),
    )
}
"""The terms by their names, in the order that arrays of all terms have: array by array, and row by row."""

PICTURES = tuple(name for name, term in TERMS.items() if term.visible)
"""The terms of what people see: the visible error of small pictures that face the viewer, and of slanted ones
(mipbake.quality.small_pictures)."""


@dataclass(frozen=True)
class Weights:
    """What all terms count at one level of detail.

    Args:
        terms: name to weight, every name of TERMS.
        group_behind: what a neper counts by which a group of pairs is behind the best rule of engines and tools in that
            very group, in the mean over groups: another rule may be the best there than in the mean over groups.
        chance: standard errors by which a row of errors may be behind.
        group_tie: nepers by which groups may be behind in the mean over them before a level gives way; a guess.
        looks_worse: nepers of a term of pictures by which a closed form may be behind the best ingredient and still be
            part of the baseline of SNR.
    """

    terms: Mapping[str, Weight]
    group_behind: float
    chance: float = 0.5
    group_tie: float = 0.02
    looks_worse: float = math.inf

    @property
    def counts(self) -> Array:
        """(T,) what every term counts."""
        return np.array([each.counts for each in self.terms.values()])

    @property
    def behind(self) -> Array:
        """(T,) what every term counts in addition while it is behind."""
        return np.array([each.behind for each in self.terms.values()])


def weights_for(aim: float) -> Weights:
    """What everybody counts who asks which of two stacks is better.

    Up to an aim of 1/2 no term of pairs may be behind the best closed form that looks fine; from there on they give
    way. The greater the aim, the better a closed form has to look for its SNR to be part of the baseline; at an aim of
    0 the SNR of all of them is.

    Args:
        aim: from 0, single lights, to 1, what people see.
    """
    return Weights(
        {name: term.weight(aim) for name, term in TERMS.items()},
        group_behind=_GROUPS * eased(aim) * (1 - aim),
        looks_worse=_LOOKS_WORSE / aim if aim else math.inf,
    )


SINGLE_LIGHTS = Weights({name: term.single_lights for name, term in TERMS.items()}, group_behind=0.0)
"""What the optimum counts, which is a limit of SNR: both pair sets, and nothing that people look at. Bright pairs count
in addition, because few of the pairs of a descent are bright, and bright ones rule the errors."""
