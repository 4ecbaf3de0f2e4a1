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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.search.ingredients import CHECK, HELD_OUT, TRAIN, Bench, Rivals
from mipbake.baking.search.level_fit import SeenAt, columns, fit_level
from mipbake.baking.search.touched import mixed
from mipbake.base.threads import side_by_side
from mipbake.material import MODELS, directions
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.scores import Score, Scores, between_levels
from mipbake.quality.judging.terms import Array
from mipbake.quality.reference.problem import Image

KEPT = (1.0, 0.75, 0.5, 0.25, 0.0)
"""How much of a level's change may be kept."""

Shares = NDArray[np.float32]
"""Of a level, as level_fit.py has them."""

Texels = Callable[[int, int, float], Image]
"""The (N, C) lookups at a probe, by its index, of a level of whose change so much is kept."""


@dataclass(frozen=True, eq=False)
class Blend:
    """A stack made of ingredients, with what was measured of these.

    Args:
        levels: (H_L, W_L, C) valid stored channels.
        sources: for each level, the names of its ingredients.
        judge: what stacks are worth by `check`, renders that nothing is fitted to. held_out: renders that decide
            nothing.
        rivals: the best closed forms at levels of detail.
        plain: (L, V) logarithm of the visible error of plain MIP maps there, by the held-out renders.
        left_out, typical: as Bench has them.
    """

    levels: list[Image]
    sources: list[tuple[str, ...]]
    judge: Judge
    check: Scores
    held_out: Scores
    rivals: list[Rivals]
    plain: Array
    left_out: tuple[str, ...] = ()
    typical: Image | None = None


def blend(bench: Bench, shares: Sequence[Shares] | None = None) -> Blend:
    """Keeps of a blend what the judge confirms. `shares`: a level each; None for the shares that `fitted` gives."""
    shares = fitted(bench) if shares is None else shares
    safe = [bench.safe(level) for level in range(bench.problem.last + 1)]

    @cache
    def made(index: int, level: int) -> Image:
        return _blended(bench, CHECK, index, level, shares[level])

    def texels(index: int, level: int, kept: float) -> Image:
        own = bench.seen(safe[level], CHECK, index, level)
        return between(own, made(index, level), kept, bench.problem.target) if kept else own

    kept = confirmed(bench.judge, bench.check, texels, len(safe))
    return _made(bench, [_mixture(bench, *each) for each in zip(shares, safe, kept, strict=True)])


def best(bench: Bench) -> Blend:
    """Every level from the one ingredient that is worth most there."""
    none = np.zeros(0, np.float32)
    return _made(bench, [_mixture(bench, none, bench.safe(level), 0.0) for level in range(bench.problem.last + 1)])


def fitted(bench: Bench) -> list[Shares]:
    """Shares of every level's blend, fitted from the coarsest level to the finest."""
    train, out = bench.sets[TRAIN], list[Shares]()
    for level in range(bench.problem.last, -1, -1):
        seen = []
        for index, share in ((2 * level, 1.0), (2 * level + 1, 0.5)):
            if index < len(train.probes):
                base, others = bench.parts(TRAIN, index, level)
                other = _blended(bench, TRAIN, index, level + 1, out[-1]) if share < 1 else None
                seen.append(SeenAt(index, share, other, base, columns(base, others, bench.problem.target)))
        out.append(fit_level(seen, train, bench.fitting))
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


def _blended(bench: Bench, which: int, index: int, level: int, shares: Shares) -> Image:
    """(N, C): a blend of a level at the points of a probe."""
    base, others = bench.parts(which, index, level)
    out: Image = base.copy()
    for k, channels in enumerate(MODELS[bench.problem.target].maps.values()):
        for other, share in zip(others, shares[k * len(others) : (k + 1) * len(others)], strict=True):
            if share:
                out[..., channels] += share * (other[..., channels] - base[..., channels])
    return material.regularise(out, bench.problem.target)


def _mixture(bench: Bench, shares: Shares, safe: str, kept: float) -> dict[str, Array]:
    """Names and (C,) shares of what a level is summed from: a blend, as much as is kept of it, and what is safe."""
    layout, out = MODELS[bench.problem.target], dict[str, Array]()
    if kept < 1:
        out[safe] = np.full(layout.channels, 1 - kept)
    if kept > 0:
        count, own = len(bench.others), np.full(layout.channels, kept)
        for k, name in enumerate(bench.others):
            share = np.zeros(layout.channels)
            for index, channels in enumerate(layout.maps.values()):
                share[channels] = kept * shares[index * count + k]
            if share.any():
                out[name] = out.get(name, 0) + share
                own -= share
        out[bench.base] = out.get(bench.base, 0) + own
    return out


def _summed(bench: Bench, mixtures: Sequence[Mapping[str, Array]]) -> list[Image]:
    """The levels of mixtures, one each."""
    problem, target = bench.problem, bench.problem.target
    names = dict.fromkeys(name for mixture in mixtures for name in mixture)
    if bench.forms:
        baked = bench.taken(name for name in names if name not in bench.forms)
        return mixed(problem, bench.whole, bench.forms, baked, mixtures)
    out = [np.zeros((*size, MODELS[target].channels), np.float32) for size in problem.sizes]
    for name in names:
        levels = bench.levels(name)
        for level, mixture in enumerate(mixtures):
            if name in mixture:
                out[level] += levels[level] * mixture[name].astype(np.float32)
    return directions.aligned([material.regularise(level, target) for level in out], target, problem.wrap)


def _made(bench: Bench, mixtures: list[dict[str, Array]]) -> Blend:
    lods = range(len(bench.check.lods))
    return Blend(
        _summed(bench, mixtures),
        [tuple(mixture) for mixture in mixtures],
        bench.judge,
        bench.check,
        bench.sets[HELD_OUT],
        [bench.rivals(index) for index in lods],
        np.stack([bench.plain_visible(index) for index in lods]),
        bench.left_out,
        bench.typical,
    )
