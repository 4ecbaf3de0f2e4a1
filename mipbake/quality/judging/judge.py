"""Which of two stacks is better: the one answer that fits, descents and the keeping of changes share.

A stack is worth, at a level of detail, what its terms count (weights.py), and what it is behind what is asked for
counts in addition. So no gain in one term is paid for by a loss in another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.judging.scores import Score, certainty
from mipbake.quality.judging.weights import TERMS, Weights

Array = NDArray[np.float64]

GROUPS = "groups"
"""The name of what groups of pairs are behind by themselves, beside the names of TERMS."""


@dataclass(frozen=True, eq=False)
class Asked:
    """What is asked for at a level of detail: what a stack must not be behind.

    Args:
        log_errors, pooled, seen: as a Score has them, measured by the same probe; each row is the best one there.
        plain: (S, G) least log_errors of the rules of engines and tools in every group; None where groups are not
            looked at one by one.
    """

    log_errors: Array
    pooled: Array
    seen: Array
    plain: Array | None = None

    @property
    def sure(self) -> Array:
        """(T,) what each term counts of its weight: 1, and less for bright pairs on which chance decides."""
        return np.concatenate([np.ones(len(self.log_errors)), certainty(self.pooled), certainty(self.seen)])

    @classmethod
    def of(cls, score: Score) -> Asked:
        """That nothing becomes worse than it is."""
        return cls(score.log_errors, score.pooled, score.seen)


@dataclass(frozen=True)
class Worth:
    """What a term adds to what a stack is worth, in nepers.

    Args:
        log: logarithm of the error. behind: by how much it is behind beyond chance; below 0 where it is ahead.
        value: what both count; less is better.
    """

    log: float
    behind: float
    value: float


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the value of a level of detail.

    Args:
        terms: (T,) by the terms. groups: (S, G) by the log_errors of groups, in addition to what the terms say.
    """

    terms: Array
    groups: Array


class Judge:
    """Says what stacks are worth.

    Args:
        asked: at every level of detail of the Scores whose scores it is given.
    """

    def __init__(self, asked: Sequence[Asked], weights: Weights) -> None:
        self.asked, self.weights = asked, weights
        self._sure = [each.sure for each in asked]

    def value(self, score: Score, index: int) -> float:
        """What a stack is worth at a level of detail, in nepers; less is better."""
        count, behind = self.weights.counts, self.weights.behind
        own = self._sure[index] * (count * score.terms + behind * np.maximum(self.behind(score, index), 0))
        return float(own.sum()) + self.weights.group_behind * self.groups_behind(score, index)

    def terms(self, score: Score, index: int) -> Mapping[str, Worth]:
        """What each term adds to the value, by the names of TERMS, and GROUPS."""
        count, urgent = self._sure[index] * self.weights.counts, self._sure[index] * self.weights.behind
        logs, behind = score.terms, self.behind(score, index)
        values = count * logs + urgent * np.maximum(behind, 0)
        rows = zip(TERMS, logs, behind, values, strict=True)
        groups = self.groups_behind(score, index)
        return {name: Worth(float(log), float(late), float(value)) for name, log, late, value in rows} | {
            GROUPS: Worth(0.0, groups, self.weights.group_behind * groups)
        }

    def behind(self, score: Score, index: int) -> Array:
        """(T,) by how much each term is behind what is asked for, beyond chance; below 0 where it is ahead."""
        asked, weights = self.asked[index], self.weights
        lost = score.log_errors - asked.log_errors, score.pooled - asked.pooled, score.seen - asked.seen
        ties = weights.tie, weights.tie, weights.seen_tie
        rows = [
            each.mean(-1) - weights.chance * standard_error(each) - tie for each, tie in zip(lost, ties, strict=True)
        ]
        return np.concatenate(rows)

    def groups_behind(self, score: Score, index: int) -> float:
        """The mean over groups of how much each is behind the rules of engines and tools, all pair sets together."""
        return float(np.maximum(self._apart(score, index), 0).mean(1).sum())

    def satisfied(self, score: Score, index: int) -> bool:
        """Whether nothing is behind what is asked for at a level of detail."""
        late = self.behind(score, index).max() > 0
        return not late and self.groups_behind(score, index) <= self.weights.group_tie

    def slopes(self, score: Score, index: int) -> Slopes:
        """Derivatives of `value`, for what chance is taken to be where the score is."""
        late = self.behind(score, index) > 0
        apart = self._apart(score, index)
        return Slopes(
            self._sure[index] * (self.weights.counts + self.weights.behind * late),
            self.weights.group_behind * (apart > 0) / apart.shape[1],
        )

    def _apart(self, score: Score, index: int) -> Array:
        plain = self.asked[index].plain
        return score.log_errors - (np.inf if plain is None else plain)


def standard_error(values: Array) -> Array:
    """Standard errors of means over the last axis."""
    return np.asarray(values.std(-1) / np.sqrt(max(1, values.shape[-1] - 1)))
