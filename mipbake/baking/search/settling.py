"""How much of a change is kept, level by level: what renders that nothing was fitted to confirm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mipbake import material
from mipbake.base.threads import side_by_side
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.scores import Score, Scores, between_levels
from mipbake.quality.reference.problem import Image

KEPT = (1.0, 0.75, 0.5, 0.25, 0.0)
"""How much of a level's change may be kept."""

Texels = Callable[[int, int, float], Image]
"""The (N, C) lookups at a probe, by its index, of a level of whose change so much is kept."""


def settle(judge: Judge, check: Scores, texels: Texels, levels: int) -> list[float]:
    """How much of each level's change is kept, so that nothing is behind what is asked for beyond chance.

    All of it, 1, is kept where nothing speaks against it.

    Args:
        judge: of the levels of detail of `check`, which are all in steps of 1/2.
    """
    kept = [1.0] * levels

    known: dict[tuple[int, tuple[float, ...]], Score] = {}  # many choices are looked at again and again

    def choice(index: int) -> tuple[int, tuple[float, ...]]:
        return index, tuple(kept[level] for level in check.probes[index].levels)

    def score(chosen: tuple[int, tuple[float, ...]]) -> Score:
        index, much = chosen
        if chosen not in known:
            seen = [texels(index, *each) for each in zip(check.probes[index].levels, much, strict=True)]
            known[chosen] = check.of(between_levels(seen), index)
        return known[chosen]

    now = side_by_side(score, [choice(index) for index in range(len(check.probes))])
    for _ in range(2):
        lost = [judge.behind(each, index).max() for index, each in enumerate(now)]
        for index in sorted(range(len(now)), key=lambda each: -lost[each]):
            if judge.satisfied(now[index], index):
                continue
            for level in check.probes[index].levels:
                near = [i for i in range(2 * level - 1, 2 * level + 2) if 0 <= i < len(now)]
                choices = []
                for much in KEPT:
                    kept[level] = much
                    choices += [choice(i) for i in near]
                scores = side_by_side(score, choices)
                tried = {much: scores[k * len(near) : (k + 1) * len(near)] for k, much in enumerate(KEPT)}
                totals = {
                    much: sum(judge.value(each, i) for each, i in zip(found, near, strict=True))
                    for much, found in tried.items()
                }
                kept[level] = min(totals, key=lambda much: totals[much])
                for i, found in zip(near, tried[kept[level]], strict=True):
                    now[i] = found
    return kept


def between(first: Image, second: Image, kept: float, model: str) -> Image:
    """first + kept (second - first), made valid; exact at both ends."""
    if kept in (0.0, 1.0):
        return second if kept else first
    return material.regularise(first + np.float32(kept) * (second - first), model)
