"""What the terms count together: every weight of what is better, and at which aim.

What a stack is worth at a level of detail is the sum of its terms, each times what it `counts`. What is behind the
baseline, which is the best closed form, counts `behind` times in addition, so that no gain in one term is paid for by a
loss in another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mipbake.quality.judging.terms import TERMS, Array, Weight, eased

_GROUPS = 6.0  # at an aim of 0
_LOOKS_WORSE = 0.25  # nepers by which forms may look worse at an aim of 1, as 0.5 was tried at one of 0.5


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

    def __post_init__(self) -> None:
        if tuple(self.terms) != tuple(TERMS):
            raise AssertionError(f"weights of {', '.join(self.terms)}: expected the names {', '.join(TERMS)}")

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
