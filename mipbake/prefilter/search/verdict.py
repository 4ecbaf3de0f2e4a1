"""How much of a change is kept, level by level: what renders that nothing was fitted to confirm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mipbake import material
from mipbake.judging.scores import Array, Score, Scores, certainty
from mipbake.judging.weights import VERDICT
from mipbake.prefilter.search.ingredients import Rival, mean
from mipbake.reference.problem import Image

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Shares of a level's change that may be kept."""

_CHANCE = 0.5  # standard errors by which a rival may be ahead
_TIE = 0.01  # logarithm of errors below which two measure the same
_APART = 0.02  # mean logarithm that is looked into: by how much groups are behind their best plain forms


@dataclass(frozen=True, eq=False)
class Held:
    """What levels are held against, at every level of detail of a judge.

    Args:
        rivals: for every row of a Score, what must not be ahead. lit: the lit_log that is asked for.
        plain: least log_errors of the rules of engines and tools in every group.
        slack: by how much `lit` may be exceeded.
    """

    rivals: Sequence[Sequence[Rival]]
    lit: Sequence[float]
    plain: Sequence[Array]
    slack: float


Texels = Callable[[int, int, float], Image]
"""The (N, C) lookups at a probe, by its index, of a level of which a share is kept."""


def settle(judge: Scores, texels: Texels, levels: int, held: Held) -> list[float]:
    """Shares of levels, so that no rival is ahead beyond chance; 1 where nothing speaks against it."""
    shares = [1.0] * levels

    def score(index: int) -> Score:
        return judge.of(mean([texels(index, level, shares[level]) for level in judge.probes[index].levels]), index)

    now = [score(index) for index in range(len(judge.probes))]
    for _ in range(2):
        lost = [_behind(each, held, index) for index, each in enumerate(now)]
        for index in sorted(range(len(now)), key=lambda each: -lost[each].max()):
            if _behind(now[index], held, index).max() <= 0 and _apart(now[index], held, index) <= _APART:
                continue
            for level in judge.probes[index].levels:
                near = [i for i in range(2 * level - 1, 2 * level + 2) if 0 <= i < len(now)]
                tried = {}
                for share in SHARES:
                    shares[level] = share
                    tried[share] = [score(i) for i in near]
                totals = {
                    share: sum(_cost(each, held, i) for each, i in zip(found, near, strict=True))
                    for share, found in tried.items()
                }
                shares[level] = min(totals, key=lambda share: totals[share])
                for i, found in zip(near, tried[shares[level]], strict=True):
                    now[i] = found
    return shares


def _behind(found: Score, held: Held, index: int) -> Array:
    """(T,) by how much each rival, and at last what is asked for under the studio's lights, is ahead beyond chance."""
    lost = [row - rival.log_errors for row, rival in zip(found.rows, held.rivals[index], strict=True)]
    rows = [each.mean() - _CHANCE * float(standard_error(each)) - _TIE for each in lost]
    return np.append(rows, found.lit_log - held.lit[index] - held.slack)


def _apart(found: Score, held: Held, index: int) -> float:
    """The mean over groups of how much each is behind what is the best for it."""
    return float(np.maximum(found.log_errors - held.plain[index], 0).mean(1).sum())


def _cost(found: Score, held: Held, index: int) -> float:
    sure, bright = found.trust.copy(), slice(len(found.log_errors), -1)
    others = np.stack([certainty(rival.log_errors) for rival in held.rivals[index][bright.start :]])
    sure[bright] = np.minimum(sure[bright], others)
    return VERDICT.value(found.terms, _behind(found, held, index), sure, _apart(found, held, index))


def between(first: Image, second: Image, share: float, model: str) -> Image:
    """first + share (second - first), made valid; exact at both ends."""
    if share in (0.0, 1.0):
        return second if share else first
    return material.regularise(first + np.float32(share) * (second - first), model)


def standard_error(values: Array) -> Array:
    """Standard errors of means over the last axis."""
    return np.asarray(values.std(-1) / np.sqrt(max(1, values.shape[-1] - 1)))
