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
"""Kinds of groups of bright pairs (bright_pairs.py). Near the mirror, views graze in the first kind, and not in the
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
    """

    terms: Mapping[str, Weight]
    group_behind: float

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

    def value(self, logs: Array, behind: Array, sure: Array, groups: float) -> float:
        """What is minimised at a level of detail, in nepers.

        Args:
            logs: (T,) terms. behind: (T,) by how much each is behind what is asked for; below 0 where it is ahead.
            sure: (T,) what each counts of its weight, from 0 to 1.
            groups: mean over groups by how much they are behind.
        """
        return (
            float((sure * (self.counts * logs + self.behind * np.maximum(behind, 0))).sum())
            + self.group_behind * groups
        )


FIT = Weights(
    {
        "near-mirror": Weight(1.0, 2.0),
        "hemisphere": Weight(1.0, 2.0),
        "grazing, near-mirror": Weight(1.0, 8.0),
        "grazing, hemisphere": Weight(0.25, 0.5),
        "highlights, near-mirror": Weight(0.5, 8.0),
        "highlights, hemisphere": Weight(0.25, 0.5),
        LIT: Weight(2.0, 16.0),
    },
    group_behind=4.0,
)
"""What fits of a level's blend are held by (search/level_fit.py). Bright pairs are few and their means uncertain: they
count less, but while they are behind they count most, since they rule the figure of a set of pairs. All numbers are
guesses: no measurement set one of them by itself."""

VERDICT = Weights(
    {
        "near-mirror": Weight(1.0, 3.0),
        "hemisphere": Weight(1.0, 3.0),
        "grazing, near-mirror": Weight(1.0, 10.0),
        "grazing, hemisphere": Weight(1.0, 3.0),
        "highlights, near-mirror": Weight(1.0, 10.0),
        "highlights, hemisphere": Weight(1.0, 3.0),
        LIT: Weight(1.0, 10.0),
    },
    group_behind=6.0,
)
"""What verdicts on finished levels are held by (search/ingredients.py, search/blending.py): guesses, as above."""


@dataclass(frozen=True)
class DescentWeights:
    """What errors count while texels descend (search/texel_descent.py, search/pair_weights.py). All are guesses.

    Args:
        kept_behind: a neper by which a share of a level's change is behind the best closed form, against one gained,
            when `optimum` chooses what it keeps.
        lit: the error under a studio's lights, beside a pair set. lit_behind: in addition, while its square is above
            `lit_slack` times the square at the start.
        pooled: the logarithm of the expected energy of a pair set, beside the mean of the logarithms of its sets.
        hurry: urgency of a level of detail and pair set grows by exp(hurry x deficit in nepers) at each look, up to
            `most_urgent`.
    """

    kept_behind: float = 10.0
    lit: float = 0.5
    lit_behind: float = 2.0
    lit_slack: float = 1.05
    pooled: float = 1.0
    hurry: float = 1.5
    most_urgent: float = 10.0


DESCENT = DescentWeights()
