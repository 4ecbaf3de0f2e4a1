"""The best blend of ingredients at every level, by measurement: closed forms, and a network.

Every ingredient is looked up at the points of two independent sets of renders, and of closed forms no level need exist
as a whole for it (ingredients.py). The first set is fitted to, each level by itself (level_fit.py). Where it still
finds a blend behind the best closed form that looks fine by more than chance, the level gives way to the ingredient
that is safe there, as far as needed: some twenty shares hardly follow the noise of the renders. The second set is held
out: it decides nothing, and measures what came of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.search.ingredients import FITTED, HELD_OUT, Bench, Rivals
from mipbake.baking.search.level_fit import SeenAt, columns, fit_level
from mipbake.baking.search.touched import mixed
from mipbake.base.threads import side_by_side
from mipbake.material import MODELS, directions
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.scores import Score, Scores
from mipbake.quality.judging.terms import Array
from mipbake.quality.reference.problem import Image

KEPT = (1.0, 0.5, 0.0)
"""How much of a level's change may be kept."""

Shares = NDArray[np.float32]
"""Of a level, as level_fit.py has them."""

Texels = Callable[[int, float], Image]
"""The (N, C) lookups at the probe of a level, of whose change so much is kept."""


@dataclass(frozen=True, eq=False)
class Blend:
    """A stack made of ingredients, with what was measured of these.

    Args:
        levels: (H_L, W_L, C) valid stored channels.
        sources: for each level, the names of its ingredients.
        judge: what stacks are worth by `check`, the renders that they were fitted to. held_out: renders that decide
            nothing.
        rivals: the best closed forms at every level.
        seen: of every level (V, N) values whose mean is the logarithm of its visible error, by `check`. plain: of plain
            MIP maps, by the same pictures.
        plain_held_out: of plain MIP maps, by the held-out renders, (L, V) the logarithm of the visible error.
        plain_decibels: (L, S) their SNR there.
        typical: as Bench has it.
    """

    levels: list[Image]
    sources: list[tuple[str, ...]]
    judge: Judge
    check: Scores
    held_out: Scores
    rivals: list[Rivals]
    seen: list[Array]
    plain: list[Array]
    plain_held_out: Array
    plain_decibels: Array
    typical: Image | None = None


def blend(bench: Bench) -> Blend:
    """Keeps of a blend what is surely gained over the ingredient that is safe.

    On polished metal a few pixels decide, and shares that were fitted to these say little of others.
    """
    levels = range(bench.problem.last + 1)
    shares, safe = fitted(bench), [bench.safe(level) for level in levels]

    def texels(level: int, kept: float) -> Image:
        own = bench.looked_up(safe[level], level)
        return between(own, _blended(bench, level, shares[level]), kept, bench.problem.target) if kept else own

    def surely(level: int) -> tuple[float, Score]:
        scores = {share: bench.sets[FITTED].of(texels(level, share), level) for share in KEPT}
        share = min(KEPT, key=lambda share: bench.judge.worth(scores[share], scores[0.0], level))
        return share, scores[share]

    kept, scores = zip(*side_by_side(surely, levels), strict=True)
    return _made(bench, [_mixture(bench, *each) for each in zip(shares, safe, kept, strict=True)], scores)


def best(bench: Bench) -> Blend:
    """Every level from the one ingredient that is worth most there."""
    none, safe = np.zeros(0, np.float32), [bench.safe(level) for level in range(bench.problem.last + 1)]
    scores = [bench.scores[level][name] for level, name in enumerate(safe)]
    return _made(bench, [_mixture(bench, none, name, 0.0) for name in safe], scores)


def fitted(bench: Bench) -> list[Shares]:
    """Shares of every level's blend."""
    target = bench.problem.target

    def fit(level: int) -> Shares:
        base, *others = (bench.looked_up(name, level) for name in (bench.base, *bench.others))
        alone = np.array([float(name == bench.safe(level)) for name in bench.others], np.float32)
        seen = SeenAt(level, base, columns(base, others, target))
        return fit_level(seen, bench.sets[FITTED], bench.judge, np.tile(alone, len(MODELS[target].maps)))

    return side_by_side(fit, range(bench.problem.last + 1))


def confirmed(judge: Judge, check: Scores, texels: Texels) -> list[tuple[float, Score]]:
    """How much of each level's change renders confirm, so that nothing is behind the baseline beyond chance, and the
    score of that.

    All of it, 1, is kept where nothing speaks against it.

    Args:
        judge: of the levels of detail of `check`, which are the levels.
    """

    def kept(level: int) -> tuple[float, Score]:
        whole = check.of(texels(level, 1.0), level)
        if judge.satisfied(whole, level):
            return 1.0, whole
        scores = {share: check.of(texels(level, share), level) for share in KEPT[1:]} | {1.0: whole}
        share = min(KEPT, key=lambda share: judge.value(scores[share], level))
        return share, scores[share]

    return side_by_side(kept, range(len(check.probes)))


def between(first: Image, second: Image, kept: float, model: str) -> Image:
    """first + kept (second - first), made valid; exact at both ends."""
    if kept in (0.0, 1.0):
        return second if kept else first
    return material.regularise(first + np.float32(kept) * (second - first), model)


def _blended(bench: Bench, level: int, shares: Shares) -> Image:
    """(N, C): a blend of a level at the points of its probe."""
    base, count = bench.looked_up(bench.base, level), len(bench.others)
    out: Image = base.copy()
    for k, channels in enumerate(MODELS[bench.problem.target].maps.values()):
        for name, share in zip(bench.others, shares[k * count : (k + 1) * count], strict=True):
            if share:
                out[..., channels] += share * (bench.looked_up(name, level)[..., channels] - base[..., channels])
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


def _made(bench: Bench, mixtures: list[dict[str, Array]], scores: Sequence[Score]) -> Blend:
    """`scores`: of the levels that mixtures make, by the renders that they were fitted to."""
    levels = range(bench.problem.last + 1)
    held_out = [bench.plain(level, HELD_OUT) for level in levels]
    return Blend(
        _summed(bench, mixtures),
        [tuple(mixture) for mixture in mixtures],
        bench.judge,
        bench.sets[FITTED],
        bench.sets[HELD_OUT],
        [bench.rivals(level) for level in levels],
        [each.visible for each in scores],
        [bench.plain(level, FITTED).visible for level in levels],
        np.stack([each.visible.mean(-1) for each in held_out]),
        np.stack([each.decibels for each in held_out]),
        bench.typical,
    )
