"""The best blend of ingredients at every level, by measurement: closed forms under both kernels, and a network.

Every ingredient is baked, looked up at the points of three independent sets of renders and forgotten: 4096 x 4096 sets
do not need fifteen stacks in memory. One set of renders is fitted to (level_fit.py), from the coarsest level to the
finest, each level together with the half level that it shares with the coarser one. Another judges. Where it finds a
blend behind the best closed form, at a level or halfway to the next, by more than chance, the levels around give way to
the ingredient that is safe there, as far as needed. The third decides nothing: it bears witness to what came of it.

With a deadline, ingredients that would take too long are left out, the least promising first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.judging.scores import Array, Effort, Score, Scores, certainty
from mipbake.judging.weights import VERDICT
from mipbake.metrics.pairs import PAIR_SETS
from mipbake.prefilter.base import Progress
from mipbake.prefilter.search.ingredients import Bench, Candidate, Rival, mean
from mipbake.reference.problem import Image, Problem

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
_CHANCE = 0.5  # standard errors by which a rival may be ahead
_TIE = 0.01  # logarithm of errors below which two measure the same
_APART = 0.02  # mean logarithm that is looked into: by how much groups are behind their best plain forms


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended stack.

    Args:
        levels: (H_L, W_L, C) valid stored channels.
        sources: for each level, the names of its ingredients.
        judge: renders that nothing was fitted to, at levels of detail in steps of 1/2.
        rivals: at each of them, the best closed form for every row of a Score. lit: the least lit_log of any.
        plain: there, the least log_errors of PLAIN in every group.
        witness: renders that decided nothing, at the same levels of detail. witnessed: what these rivals have there.
        left_out: closed forms that there was no time to bake, in none of the above.
    """

    levels: list[Image]
    sources: list[tuple[str, ...]]
    judge: Scores
    rivals: list[list[Rival]]
    lit: list[float]
    plain: list[Array]
    witness: Scores
    witnessed: list[list[Rival]]
    left_out: tuple[str, ...] = ()


def blend(
    problem: Problem,
    candidates: Sequence[Candidate],
    effort: Effort,
    seed: int = 0,
    progress: Progress = lambda _: None,
    deadline: float = math.inf,
) -> Blend:
    """Fits every level, coarsest first, and keeps of it what independent renders confirm.

    Args:
        candidates: the ingredients, in the order of preference where they measure the same, BASE with the pixel filter
            among them. A network need not be.
        effort: of the renders that judge; those that are fitted to have half the points.
        deadline: time.monotonic() by which all ingredients are baked; ingredients that would not be are left out.
    """
    # A handful of weights a level needs fewer points than a verdict on them.
    fewer = replace(
        effort,
        groups=max(1, 2 * effort.groups // 3),
        points=max(1, 3 * effort.points // 4),
        lit_points=max(1, effort.lit_points // 2),
    )
    third = replace(effort, groups=max(2, effort.groups // 2), lit_points=1)
    with ThreadPoolExecutor(2) as pool:
        drawn = [
            pool.submit(Scores, problem, each, 3 * seed + index) for index, each in enumerate((fewer, effort, third))
        ]
        train, judge, witness = (each.result() for each in drawn)
    bench = Bench(problem, candidates, (train, judge), witness, progress, deadline)
    asked = [bench.asked(0, index) for index in range(len(train.lods))]
    weights = _fitted(bench, train, asked)
    safe = [bench.safest(level, asked) for level in range(problem.last + 1)]
    rivals = [bench.rivals(index) for index in range(len(judge.lods))]
    plain = [bench.plain(bench.judged[index]) for index in range(len(judge.lods))]
    lit = [bench.asked(1, index).lit_log for index in range(len(judge.lods))]
    shares = _settled(bench, judge, weights, safe, rivals, lit, plain)
    mixtures = [bench.mixture(*each) for each in zip(weights, safe, shares, strict=True)]
    levels = bench.mixed(mixtures)
    witnessed = [bench.witnessed(index, each[: len(PAIR_SETS)]) for index, each in enumerate(rivals)]
    progress(1.0)
    sources = [tuple(mixture) for mixture in mixtures]
    return Blend(levels, sources, judge, rivals, lit, plain, witness, witnessed, bench.left_out)


def _fitted(bench: Bench, train: Scores, asked: Sequence[Score]) -> list[NDArray[np.float32]]:
    """Weights of every level."""
    from mipbake.prefilter.search.level_fit import Term, columns, fit_level

    target, last = bench.problem.target, bench.problem.last
    out: list[NDArray[np.float32]] = []
    for level in range(last, -1, -1):
        terms = []
        for index, share in ((2 * level, 1.0), (2 * level + 1, 0.5)):
            if index < len(train.probes):
                base, others = bench.parts(0, index, level)
                other = bench.fitted(0, index, level + 1, out[-1]) if share < 1 else None
                made = columns(base, others, target)
                terms.append(Term(train.probes[index], asked[index], share, other, base, made))
        out.append(fit_level(terms, target, train.lighting))
    return out[::-1]


def _settled(
    bench: Bench,
    judge: Scores,
    weights: Sequence[NDArray[np.float32]],
    safe: Sequence[str],
    rivals: Sequence[Sequence[Rival]],
    lit: Sequence[float],
    plain: Sequence[Array],
) -> list[float]:
    """For each level the share of its blend against its safe ingredient, so that no rival is ahead beyond chance."""
    target = bench.problem.target

    def texels(index: int, level: int, share: float) -> Image:
        if share == 1:
            return bench.fitted(1, index, level, weights[level])
        own = bench.seen(safe[level], 1, index, level)
        if share == 0:
            return own
        return material.regularise(own + np.float32(share) * (texels(index, level, 1.0) - own), target)

    return settle(judge, texels, len(safe), rivals, lit, plain)


def settle(
    judge: Scores,
    texels: Callable[[int, int, float], Image],
    levels: int,
    rivals: Sequence[Sequence[Rival]],
    lit: Sequence[float],
    plain: Sequence[Array],
    slack: float = 0.25,
) -> list[float]:
    """Shares of levels, 1 where nothing speaks against it.

    Args:
        texels: of a probe's index, a level and a share, the (N, C) lookups.
        levels: how many there are.
        rivals, lit, plain: as Blend has them. slack: by how much lit may be exceeded.
    """
    shares = [1.0] * levels

    def score(index: int) -> Score:
        return judge.of(mean([texels(index, level, shares[level]) for level in judge.probes[index].levels]), index)

    def behind(found: Score, index: int) -> Array:
        """By how much each rival, and the last one under the studio's lights, is ahead beyond what chance may do."""
        lost = [row - rival.log_errors for row, rival in zip(found.rows, rivals[index], strict=True)]
        rows = [each.mean() - _CHANCE * float(standard_error(each)) - _TIE for each in lost]
        return np.append(rows, found.lit_log - lit[index] - slack)

    def cost(found: Score, index: int) -> float:
        others = np.stack([certainty(rival.log_errors) for rival in rivals[index][len(found.log_errors) :]])
        sure, bright = found.trust.copy(), slice(len(found.log_errors), -1)
        sure[bright] = np.minimum(sure[bright], others)
        return VERDICT.value(found.terms, behind(found, index), sure, apart(found, index))

    def apart(found: Score, index: int) -> float:
        """The mean over groups of how much each is behind what is the best for it."""
        return float(np.maximum(found.log_errors - plain[index], 0).mean(1).sum())

    now = [score(index) for index in range(len(judge.probes))]
    for _ in range(2):
        worst = sorted(range(len(now)), key=lambda each: -behind(now[each], each).max())
        for index in (each for each in worst if behind(now[each], each).max() > 0 or apart(now[each], each) > _APART):
            for level in judge.probes[index].levels:
                near = [i for i in range(2 * level - 1, 2 * level + 2) if 0 <= i < len(now)]
                tried = {}
                for share in SHARES:
                    shares[level] = share
                    tried[share] = [score(i) for i in near]
                totals = {s: sum(cost(f, i) for f, i in zip(found, near, strict=True)) for s, found in tried.items()}
                shares[level] = min(totals, key=lambda share: totals[share])
                for i, found in zip(near, tried[shares[level]], strict=True):
                    now[i] = found
    return shares


def standard_error(values: Array) -> Array:
    """Standard errors of means over the last axis."""
    return np.asarray(values.std(-1) / np.sqrt(max(1, values.shape[-1] - 1)))
