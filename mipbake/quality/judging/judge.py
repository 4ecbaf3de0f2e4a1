"""Which of two stacks is better: the one answer that fits, descents and the keeping of changes share.

What a stack is worth at a level of detail is the sum of its terms (terms.py), each times what it `counts`. What is
behind a baseline, which is the best closed form, counts `behind` times in addition, so that no gain in one term is paid
for by a loss in another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mipbake.quality.judging.scores import Score
from mipbake.quality.judging.terms import ARRAYS, LOG_ERRORS, TERMS, Array, Weights, certainty, standard_error


@dataclass(frozen=True, eq=False)
class Baseline:
    """What a stack must not be behind at a level of detail.

    Args:
        values: term to its (N,) values, measured by the same probe; each is the best one there.
        plain: (S, G) least log_errors of the rules of engines and tools in every group; None where groups are not
            looked at one by one.
    """

    values: Mapping[str, Array]
    plain: Array | None = None

    @property
    def certainties(self) -> Array:
        """(T,) what each term counts of its weight: 1, and less for bright pairs on which chance decides."""
        return np.array(
            [1.0 if each.array == LOG_ERRORS else certainty(self.values[name]) for name, each in TERMS.items()]
        )

    @classmethod
    def of(cls, score: Score, plain: Array | None = None) -> Baseline:
        """That nothing becomes worse than it is."""
        return cls({name: term.values(score) for name, term in TERMS.items()}, plain)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the value of a level of detail.

    Args:
        log_errors, pooled, visible: (rows,) by the means of the rows of these arrays of a Score.
        groups: (S, G) by the log_errors of groups, in addition.
    """

    log_errors: Array
    pooled: Array
    visible: Array
    groups: Array


_LOST = 0.05  # nepers of a term that may be lost for a gain in others; a guess
_FAR, _SURE = 0.2, 1.0  # nepers by which a stack is far behind, and standard errors that make it sure; guesses


class Judge:
    """Says what stacks are worth.

    Args:
        baselines: at every level of detail of the Scores whose scores it is given.
    """

    def __init__(self, baselines: Sequence[Baseline], weights: Weights) -> None:
        self.baselines, self.weights = baselines, weights
        self._certain = [each.certainties for each in baselines]
        rows = [(name, term.array) for name, term in TERMS.items()]
        # Rows of an array are one operation, which takes as long as one row.
        self._best = [
            {array: np.stack([each.values[name] for name, of in rows if of == array]) for array in ARRAYS}
            for each in baselines
        ]
        self._ties = np.array([weights.terms[name].tie for name in TERMS])

    def value(self, score: Score, index: int) -> float:
        """What a stack is worth at a level of detail, in nepers; less is better."""
        count, behind = self.weights.counts, self.weights.behind
        own = self._certain[index] * (count * score.terms + behind * np.maximum(self.behind(score, index), 0))
        return float(own.sum()) + self.weights.group_behind * self.groups_behind(score, index)

    def behind(self, score: Score, index: int) -> Array:
        """(T,) by how much each term is behind the baseline, beyond chance; below 0 where it is ahead."""
        lost, errors = self._lost(score, self._best[index])
        return np.asarray(lost - self.weights.chance * errors - self._ties)

    def worth(self, score: Score, safe: Score, index: int) -> float:
        """`value`, and a standard error of what is gained over a safe stack; infinite where a term is surely lost to
        it, unless it is itself far behind the baseline."""
        lost, errors = self._lost(score, {each: getattr(safe, each) for each in self._best[index]})
        behind, unsure = self._lost(safe, self._best[index])
        if (lost - self.weights.chance * errors > _LOST).any() and (behind - _SURE * unsure < _FAR).all():
            return math.inf
        return self.value(score, index) + float((self._certain[index] * self.weights.counts * errors).sum())

    @staticmethod
    def _lost(score: Score, to: Mapping[str, Array]) -> tuple[Array, Array]:
        """(T,) by how much each term is behind another's rows, and standard errors of that."""
        apart = [getattr(score, array) - rows for array, rows in to.items()]
        return np.concatenate([each.mean(-1) for each in apart]), np.concatenate([*map(standard_error, apart)])

    def groups_behind(self, score: Score, index: int) -> float:
        """The mean over groups of how much each is behind the rules of engines and tools, all pair sets together."""
        return float(np.maximum(self._apart(score, index), 0).mean(1).sum())

    def satisfied(self, score: Score, index: int) -> bool:
        """Whether nothing is behind the baseline at a level of detail."""
        late = self.behind(score, index).max() > 0
        return not late and self.groups_behind(score, index) <= self.weights.group_tie

    def slopes(self, score: Score, index: int) -> Slopes:
        """Derivatives of `value`, for what chance is taken to be where the score is."""
        late, apart = self.behind(score, index) > 0, self._apart(score, index)
        groups = self.weights.group_behind * (apart > 0) / apart.shape[1]
        log_errors, pooled, visible = (np.zeros(len(each)) for each in (score.log_errors, score.pooled, score.visible))
        out = Slopes(log_errors, pooled, visible, groups)
        own = self._certain[index] * (self.weights.counts + self.weights.behind * late)
        for term, slope in zip(TERMS.values(), own, strict=True):
            getattr(out, term.array)[term.row] += slope
        return out

    def _apart(self, score: Score, index: int) -> Array:
        plain = self.baselines[index].plain
        return score.log_errors - (np.inf if plain is None else plain)
