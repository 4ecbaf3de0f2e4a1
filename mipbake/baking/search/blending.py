"""The best blend of ingredients at every level, by measurement: closed forms under both kernels, and a network.

Every ingredient is looked up at the points of three independent sets of renders, and of closed forms no level need
exist as a whole for it (ingredients.py). One set of renders is fitted to (level_fit.py), from the coarsest level to the
finest, each level together with the half level that it shares with the coarser one. Another judges. Where it finds a
blend behind the best closed form that looks fine, at a level or halfway to the next, by more than chance, the levels
around give way to the ingredient that is safe there, as far as needed. The third decides nothing: it bears witness to
what came of it.

With a deadline, ingredients that would take too long are left out, the least promising first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.prefilter import Progress
from mipbake.baking.search.ingredients import Bench, Ingredient, Rival
from mipbake.baking.search.level_fit import SeenAt, columns, fit_level
from mipbake.baking.search.settling import between, settle
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.judging.weights import Weights
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Image, Problem


@dataclass(frozen=True, eq=False)
class Gathered:
    """Ingredients, and the renders that they were looked up in.

    Args:
        train: renders that blends are fitted to. check: renders that nothing is fitted to, at levels of detail in steps
            of 1/2. witness: renders that decide nothing, at the same levels of detail.
        fitting: what stacks are worth by `train`, held against the best closed forms that look fine. judge: the same by
            `check`.
    """

    bench: Bench
    train: Scores
    check: Scores
    witness: Scores
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
        judge, check, witness: as Gathered has them.
        witnessed: what the best closed forms of pair sets have, by the witness.
        plain: (L, V) logarithm of the visible error of plain MIP maps at levels of detail, by the witness.
        left_out: closed forms that there was no time to bake, in none of the above.
        typical: as Bench has it.
    """

    levels: list[Image]
    sources: list[tuple[str, ...]]
    judge: Judge
    check: Scores
    witness: Scores
    witnessed: list[list[Rival]]
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
    train, check, witness = _renders(problem, _efforts(effort), seed)
    bench = Bench(problem, ingredients, (train, check), witness, progress, deadline)
    lods = range(len(check.lods))
    fitting, judge = (
        Judge([bench.asked(which, index, judged_by.looks_worse) for index in lods], judged_by) for which in (0, 1)
    )
    return Gathered(bench, train, check, witness, fitting, judge)


def judging_renders(problem: Problem, effort: ProbeEffort, seed: int) -> tuple[Scores, Scores]:
    """The renders that judge, and the witness, as `gathered` draws them."""
    _, *efforts = _efforts(effort)
    check, witness = _renders(problem, efforts, seed, first=1)
    return check, witness


def _efforts(effort: ProbeEffort) -> list[ProbeEffort]:
    """Of the renders that are fitted to, the renders that judge, and the witness."""
    # A handful of shares a level needs fewer points than to settle what is kept of them.
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

    kept = settle(found.judge, found.check, texels, len(safe))
    return _made(found, [found.bench.mixture(*each) for each in zip(shares, safe, kept, strict=True)])


def best(found: Gathered) -> Blend:
    """Every level from the one ingredient that comes nearest to what is asked for."""
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


def _made(found: Gathered, mixtures: list[dict[str, NDArray[np.float64]]]) -> Blend:
    bench = found.bench
    levels = bench.mixed(mixtures)
    rivals = [bench.rivals(1, index)[: len(PAIR_SETS)] for index in range(len(found.check.lods))]
    witnessed = [bench.witnessed(index, each) for index, each in enumerate(rivals)]
    plain = np.stack([bench.plain_looks(index) for index in range(len(rivals))])
    sources = [tuple(mixture) for mixture in mixtures]
    renders = found.judge, found.check, found.witness
    return Blend(levels, sources, *renders, witnessed, plain, bench.left_out, bench.typical)
