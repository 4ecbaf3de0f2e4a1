"""What errors count: every weight of what is better, in one place.

Stacks are compared by terms, each the logarithm of an error relative to the signal at a level of detail. What a stack
is worth there is the sum of its terms, each times what it `counts`. What is behind what is asked for, the best closed
form, counts `behind` times in addition, so that no gain in one term is paid for by a loss in another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.metrics.pairs import PAIR_SETS

Array = NDArray[np.float64]

BRIGHT = ("grazing", "highlights")
"""Kinds of groups of bright pairs (pairs.py). Near the mirror, views graze in the first kind, and not in the
second; over the hemisphere both kinds are drawn alike."""

LIT = "lit"
"""The term of surfaces under a studio's lights, as a display shows them (lit_renders.py)."""

TERMS = (*PAIR_SETS, *(f"{kind}, {name}" for kind in BRIGHT for name in PAIR_SETS), LIT)
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
        chance: standard errors by which a row of errors may be behind; a guess.
        tie: nepers below which two errors measure the same. lit_tie: the same, of the error under the studio's lights.
        group_tie: nepers by which groups may be behind in the mean over them before a level gives way.

    The ties are guesses, too.
    """

    terms: Mapping[str, Weight]
    group_behind: float
    chance: float = 0.5
    tie: float = 0.01
    lit_tie: float = 0.1
    group_tie: float = 0.02

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


WEIGHTS = Weights(
    {
        "near-mirror": Weight(1.0, 3.0),
        "hemisphere": Weight(1.0, 3.0),
        "grazing, near-mirror": Weight(1.0, 10.0),
        "grazing, hemisphere": Weight(1.0, 3.0),
        "highlights, near-mirror": Weight(1.0, 10.0),
        "highlights, hemisphere": Weight(1.0, 3.0),
        LIT: Weight(0.8, 8.0),
    },
    group_behind=6.0,
)
"""What everybody counts who asks which of two stacks is better. Terms of pairs count alike, and what falls behind where
one bright pair rules a set of pairs counts most. All of them are guesses. benchmarks/RESULTS-weights.md shows what each
does: what `auto` gains and loses where it is halved and where it is doubled."""

SINGLE_LIGHTS = Weights(
    {
        "near-mirror": Weight(1.0, 10.0),
        "hemisphere": Weight(1.0, 10.0),
        "grazing, near-mirror": Weight(0.5, 0.0),
        "grazing, hemisphere": Weight(0.5, 0.0),
        "highlights, near-mirror": Weight(0.5, 0.0),
        "highlights, hemisphere": Weight(0.5, 0.0),
        LIT: Weight(0.0, 0.0),
    },
    group_behind=0.0,
)
"""What the optimum counts, which is a limit of SNR: both pair sets, and nothing that people look at. Bright pairs count
in addition, because few of the pairs of a descent are bright, and bright ones rule the errors. Guesses."""
