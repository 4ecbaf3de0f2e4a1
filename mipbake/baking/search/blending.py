"""The best blend of ingredients at every level, by measurement: closed forms under both kernels, and a network.

Every ingredient is looked up at the points of three independent sets of renders, and of closed forms no level need
exist as a whole for it (ingredients.py). One set of renders is fitted to (level_fit.py), from the coarsest level to the
finest, each level together with the half level that it shares with the coarser one. Another judges. Where it finds a
blend behind the best closed form that looks fine, at a level or halfway to the next, by more than chance, the levels
around give way to the ingredient that is safe there, as far as needed. The third is held out: it decides nothing, and
measures what came of it.

With a deadline, ingredients that would take too long are left out, the ones that matter least first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.prefilter import Progress
from mipbake.baking.search.ingredients import Bench, Ingredient, Rivals
from mipbake.baking.search.level_fit import SeenAt, columns, fit_level
from mipbake.base.threads import side_by_side
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Score, Scores, between_levels
from mipbake.quality.judging.weights import Weights
from mipbake.quality.reference.problem import Image, Problem

KEPT = (1.0, 0.75, 0.5, 0.25, 0.0)
"""How much of a level's change may be kept."""

Texels = Callable[[int, int, float], Image]
"""The (N, C) lookups at a probe, by its index, of a level of whose change so much is kept."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """Ingredients, and the renders that they were looked up in.

    Args:
        train: renders that blends are fitted to. check: renders that nothing is fitted to, at levels of detail in steps
            of 1/2. held_out: renders that decide nothing, at the same levels of detail.
        fitting: what stacks are worth by `train`, held against the best closed forms that look fine. judge: the same by
            `check`.
    """

    bench: Bench
    train: Scores
    check: Scores
    held_out: Scores
    fitting: Judge
    judge: Judge

    @property
    def problem(self) -> Problem:
        """What the ingredients were baked for."""
        return self.bench.problem

    def safe(self, level: int) -> str:
        """The ingredient that is worth most at a level."""
        return self.bench.safest(level, self.fitting)


@dataclass(frozen=True, eq=False)
class Blend:
    """A stack made of ingredients.

    Args:
        levels: (H_L, W_L, C) valid stored channels.
        sources: for each level, the names of its ingredients.
        judge, check, held_out: as Gathered has them.
        rivals: the best closed forms at levels of detail.
        plain: (L, V) logarithm of the visible error of plain MIP maps there, by the held-out renders.
        left_out: closed forms that there was no time to bake, in none of the above.
        typical: as Bench has it.
    """

    levels: list[Image]
    sources: list[tuple[str, ...]]
    judge: Judge
    check: Scores
    held_out: Scores
    rivals: list[Rivals]
    plain: NDArray[np.float64]
    left_out: tuple[str, ...] = ()
    typical: Image | None = None


def gathered(
    problem: Problem,
    ingredients: Sequence[Ingredient],
    effort: ProbeEffort,
    judged_by: Weights,
    seed: int = 0,
    progress: Progress = lambda _: None,
    deadline: float = math.inf,
) -> Gathered:
    """Bakes ingredients and looks them up in three sets of renders.

    Args:
        ingredients: the ingredients, in the order of preference where they measure the same, BASE with the pixel filter
            among them. A network need not be.
        effort: of the renders that judge; those that are fitted to have half the points.
        deadline: time.monotonic() by which all ingredients are baked; ingredients that would not be are left out.
        judged_by: what errors count.
    """
    train, check, held_out = _renders(problem, _efforts(effort), seed)
    bench = Bench(problem, ingredients, (train, check), held_out, progress, deadline)
    lods = range(len(check.lods))
    fitting, judge = (
        Judge([bench.baseline(which, index, judged_by.looks_worse) for index in lods], judged_by) for which in (0, 1)
    )
    return Gathered(bench, train, check, held_out, fitting, judge)


def judging_renders(problem: Problem, effort: ProbeEffort, seed: int) -> tuple[Scores, Scores]:
    """The renders that judge, and the held-out ones, as `gathered` draws them."""
    _, *efforts = _efforts(effort)
    check, held_out = _renders(problem, efforts, seed, first=1)
    return check, held_out


def _efforts(effort: ProbeEffort) -> list[ProbeEffort]:
    """Of the renders that are fitted to, the renders that judge, and the held-out ones."""
    # A handful of shares a level needs fewer points than to decide what is kept of them.
    fewer = replace(
        effort,
        groups=max(1, 2 * effort.groups // 3),
        points=max(1, 3 * effort.points // 4),
        pictures=max(1, effort.pictures // 2),
    )
    return [fewer, effort, replace(effort, groups=max(2, effort.groups // 2), pictures=1)]


def _renders(problem: Problem, made_with: Sequence[ProbeEffort], seed: int, first: int = 0) -> list[Scores]:
    with ThreadPoolExecutor(2) as pool:
        drawn = [pool.submit(Scores, problem, each, 3 * seed + index) for index, each in enumerate(made_with, first)]
        return [each.result() for each in drawn]


def blend(found: Gathered, shares: Sequence[NDArray[np.float32]] | None = None) -> Blend:
    """Keeps of a blend what the judge confirms. `shares`: a level each; None for the shares that `fitted` gives."""
    shares = fitted(found) if shares is None else shares
    safe = [found.safe(level) for level in range(found.problem.last + 1)]

    @cache
    def made(index: int, level: int) -> Image:
        return found.bench.fitted(1, index, level, shares[level])

    def texels(index: int, level: int, kept: float) -> Image:
        own = found.bench.seen(safe[level], 1, index, level)
        return between(own, made(index, level), kept, found.problem.target) if kept else own

    kept = confirmed(found.judge, found.check, texels, len(safe))
    return _made(found, [found.bench.mixture(*each) for each in zip(shares, safe, kept, strict=True)])


def best(found: Gathered) -> Blend:
    """Every level from the one ingredient that is worth most there."""
    none = np.zeros(0, np.float32)
    mixtures = [found.bench.mixture(none, found.safe(level), 0.0) for level in range(found.problem.last + 1)]
    return _made(found, mixtures)


def fitted(found: Gathered) -> list[NDArray[np.float32]]:
    """Shares of every level's blend, fitted from the coarsest level to the finest."""
    bench, train = found.bench, found.train
    target, last = found.problem.target, found.problem.last
    out: list[NDArray[np.float32]] = []
    for level in range(last, -1, -1):
        seen = []
        for index, share in ((2 * level, 1.0), (2 * level + 1, 0.5)):
            if index < len(train.probes):
                base, others = bench.parts(0, index, level)
                other = bench.fitted(0, index, level + 1, out[-1]) if share < 1 else None
                seen.append(SeenAt(index, share, other, base, columns(base, others, target)))
        out.append(fit_level(seen, train, found.fitting))
    return out[::-1]


def confirmed(judge: Judge, check: Scores, texels: Texels, levels: int) -> list[float]:
    """How much of each level's change renders confirm, so that nothing is behind the baseline beyond chance.

    All of it, 1, is kept where nothing speaks against it.

    Args:
        judge: of the levels of detail of `check`, which are all in steps of 1/2.
    """
    kept = [1.0] * levels

    known: dict[tuple[int, tuple[float, ...]], Score] = {}  # many choices are looked at again and again

    def choice(index: int) -> tuple[int, tuple[float, ...]]:
        return index, tuple(kept[level] for level in check.probes[index].levels)

    def score(chosen: tuple[int, tuple[float, ...]]) -> Score:
        index, shares = chosen
        if chosen not in known:
            seen = [texels(index, *each) for each in zip(check.probes[index].levels, shares, strict=True)]
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
                for share in KEPT:
                    kept[level] = share
                    choices += [choice(i) for i in near]
                scores = side_by_side(score, choices)
                tried = {share: scores[k * len(near) : (k + 1) * len(near)] for k, share in enumerate(KEPT)}
                totals = {
                    share: sum(judge.value(each, i) for each, i in zip(found, near, strict=True))
                    for share, found in tried.items()
                }
                kept[level] = min(totals, key=lambda share: totals[share])
                for i, found in zip(near, tried[kept[level]], strict=True):
                    now[i] = found
    return kept


def between(first: Image, second: Image, kept: float, model: str) -> Image:
    """first + kept (second - first), made valid; exact at both ends."""
    if kept in (0.0, 1.0):
        return second if kept else first
    return material.regularise(first + np.float32(kept) * (second - first), model)


def _made(found: Gathered, mixtures: list[dict[str, NDArray[np.float64]]]) -> Blend:
    bench = found.bench
    levels = bench.mixed(mixtures)
    lods = range(len(found.check.lods))
    rivals, plain = [bench.rivals(index) for index in lods], np.stack([bench.plain_visible(index) for index in lods])
    sources = [tuple(mixture) for mixture in mixtures]
    renders = found.judge, found.check, found.held_out
    return Blend(levels, sources, *renders, rivals, plain, bench.left_out, bench.typical)
