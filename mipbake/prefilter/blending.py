"""The best blend of candidates at every level, by measurement: closed forms under both kernels, and a network.

Every candidate is baked, looked up at the points of two independent sets of renders and forgotten: 4096 x 4096 sets do
not need fifteen stacks in memory. One set of renders is fitted to (level_fit.py), from the coarsest level to the
finest, each level together with the half level that it shares with the coarser one. The other judges. Where it finds a
blend behind the best closed form, at a level or halfway to the next, by more than chance, the levels around give way to
the candidate that is safe there, as far as needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.material import MODELS
from mipbake.metrics.pairs import PAIR_SETS
from mipbake.prefilter.base import Prefilter, Progress
from mipbake.prefilter.held_out import Image, Problem
from mipbake.prefilter.scores import Array, Effort, Score, Scores

KERNEL_OF_ORIGIN = "box"
BASE = "linear"
BLENDED = ("linear", "lean", "unreal", "godot")
"""Closed forms that blends are made of, each with the pixel filter; BASE with the box, too."""

SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
_MEMORY = 1 << 30  # bytes of blended candidates that are kept rather than baked twice
_CHANCE = 0.5  # of a standard error by which a rival may be ahead
_TIE = 0.01  # logarithm of errors below which two measure the same
_SIDE_BY_SIDE = 1 << 25  # values of a stack up to which two candidates are baked at a time
_WORSE = 10.0  # weight of a logarithm behind what is asked for against one gained


@dataclass(frozen=True)
class Candidate:
    """A stack that may be baked.

    Args:
        name: what people call it: `lean (box)`, `neural`.
        closed_form: whether it is one.
        bake: gives its levels.
    """

    name: str
    closed_form: bool
    bake: Callable[[], list[Image]]


@dataclass(frozen=True, eq=False)
class Rival:
    """The best closed form at a level of detail, for one pair set.

    Args:
        name: what people call it. log_errors: (G,) as Score has them.
    """

    name: str
    log_errors: Array


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended stack.

    Args:
        levels: (H_L, W_L, C) valid stored channels.
        sources: of each level, the names of the candidates in it.
        judge: renders that nothing was fitted to, at levels of detail in steps of 1/2.
        rivals: at each of them, the best closed form for every pair set. lit: the least lit_square of closed forms.
    """

    levels: list[Image]
    sources: list[tuple[str, ...]]
    judge: Scores
    rivals: list[list[Rival]]
    lit: list[float]


def closed_forms(problem: Problem) -> Iterator[Candidate]:
    """Every closed form, with the pixel filter and with the box as its averaging kernel."""
    from mipbake.prefilter import METHODS

    for kernel in dict.fromkeys((problem.pixel_filter, KERNEL_OF_ORIGIN)):
        for method in METHODS.values():
            if method.averages:
                yield candidate(problem, method, kernel)


def candidate(problem: Problem, method: Prefilter, kernel: str, progress: Progress = lambda _: None) -> Candidate:
    """A method as a candidate."""

    def bake() -> list[Image]:
        p = problem
        return method(p.stored, p.source, p.target, kernel, p.wrap, progress).levels

    return Candidate(f"{method.name} ({kernel})" if method.averages else method.name, method.averages, bake)


def blend(
    problem: Problem,
    candidates: Sequence[Candidate],
    effort: Effort,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Blend:
    """Fits every level, coarsest first, and keeps of it what independent renders confirm.

    Args:
        candidates: in the order of preference where they measure the same, BASE with the pixel filter among them. A
            network need not be.
        effort: of the renders that judge; those that are fitted to have half the points.
    """
    # A handful of weights a level needs fewer points than a verdict on them.
    fewer = replace(
        effort,
        groups=max(1, 2 * effort.groups // 3),
        points=max(1, 3 * effort.points // 4),
        lit_points=max(1, effort.lit_points // 2),
    )
    train, judge = Scores(problem, fewer, 2 * seed), Scores(problem, effort, 2 * seed + 1)
    bench = _Bench(problem, candidates, (train, judge), progress)
    asked = [bench.asked(0, index) for index in range(len(train.lods))]
    weights = _fitted(bench, train, asked)
    safe = [bench.safest(level, asked) for level in range(problem.last + 1)]
    rivals = [bench.rivals(index) for index in range(len(judge.lods))]
    lit = [bench.asked(1, index).lit_square for index in range(len(judge.lods))]
    shares = _settled(bench, judge, weights, safe, rivals, lit)
    mixtures = [bench.mixture(*each) for each in zip(weights, safe, shares, strict=True)]
    levels = bench.mixed(mixtures)
    progress(1.0)
    return Blend(levels, [tuple(mixture) for mixture in mixtures], judge, rivals, lit)


class _Bench:
    """All candidates, looked up at all points of several sets of renders, and scored."""

    def __init__(
        self, problem: Problem, candidates: Sequence[Candidate], scores: Sequence[Scores], progress: Progress
    ) -> None:
        self.problem, self._scores = problem, scores
        self._candidates = {each.name: each for each in candidates}
        form = f"{{}} ({problem.pixel_filter})"
        self.base = form.format(BASE)
        others = [form.format(name) for name in BLENDED[1:]]
        others += [f"{BASE} ({KERNEL_OF_ORIGIN})", *(each.name for each in candidates if not each.closed_form)]
        self.others = [name for name in dict.fromkeys(others) if name in self._candidates and name != self.base]
        texels = sum(height * width for height, width in problem.sizes) * MODELS[problem.target].channels
        self._keep = (1 + len(self.others)) * texels * 4 <= _MEMORY
        self._kept: dict[str, list[Image]] = {}
        if problem.target == "gltf-anisotropic":
            self._kept[self.base] = self._candidates[self.base].bake()
        self._looked_up: dict[tuple[str, int, int, int], Image] = {}
        self._found: dict[tuple[str, int], list[Score]] = {}
        names = sorted(self._candidates, key=lambda name: name != self.base)

        def look(name: str) -> None:
            levels = self.levels(name)
            for which, each in enumerate(scores):
                self._look_up(name, levels, which, each)

        # Closed forms are NumPy, which uses one core; stacks of large sets do not fit into memory twice.
        workers = 2 if texels <= _SIDE_BY_SIDE else 1
        with ThreadPoolExecutor(workers) as pool:
            for done, _ in enumerate(pool.map(look, names)):
                progress((done + 1) / (len(names) + 2))

    def levels(self, name: str) -> list[Image]:
        """Every level of a candidate, baked again unless it was kept."""
        if name in self._kept:
            return self._kept[name]
        levels = self._candidates[name].bake()
        if self.problem.target == "gltf-anisotropic":  # directions d and -d are one; blends must not cancel
            for level, base in zip(levels, self._kept[self.base], strict=True):
                apart = (level[..., 8:10] * base[..., 8:10]).sum(-1, keepdims=True) < 0
                level[..., 8:10] = np.where(apart, -level[..., 8:10], level[..., 8:10])
        if self._keep and name in (self.base, *self.others):
            self._kept[name] = levels
        return levels

    def _look_up(self, name: str, levels: list[Image], which: int, scores: Scores) -> None:
        found = []
        for index, probe in enumerate(scores.probes):
            seen = [scores.looked_up(levels[level], index) for level in probe.levels]
            for level, texels in zip(probe.levels, seen, strict=True):
                self._looked_up[name, which, index, level] = texels
            found.append(scores.of(mean(seen), index))
        self._found[name, which] = found

    def seen(self, name: str, which: int, index: int, level: int) -> Image:
        """(N, C): a level of a candidate at the points of a probe."""
        return self._looked_up[name, which, index, level]

    def fitted(self, which: int, index: int, level: int, weights: NDArray[np.float32]) -> Image:
        """(N, C): a fitted blend there."""
        base, others = self.parts(which, index, level)
        return material.regularise(blended(base, others, weights, self.problem.target), self.problem.target)

    def parts(self, which: int, index: int, level: int) -> tuple[Image, list[Image]]:
        """What blends are made of, at the points of a probe."""
        return self.seen(self.base, which, index, level), [self.seen(n, which, index, level) for n in self.others]

    def rivals(self, index: int) -> list[Rival]:
        """The best closed form of each pair set at a level of detail, as the judge sees it."""
        forms = {name: self._found[name, 1][index].log_errors for name, c in self._candidates.items() if c.closed_form}
        means = {name: rows.mean(1) for name, rows in forms.items()}
        best = [min(means, key=lambda name, kind=kind: float(means[name][kind])) for kind in range(len(PAIR_SETS))]  # type: ignore[misc]
        return [Rival(name, forms[name][kind]) for kind, name in enumerate(best)]

    def asked(self, which: int, index: int) -> Score:
        """The least errors of all closed forms: each row of log_errors is that of the best one."""
        found = [self._found[name, which][index] for name, c in self._candidates.items() if c.closed_form]
        logs = np.stack([each.log_errors for each in found])
        best = logs.mean(2).argmin(0)
        rows = np.stack([logs[form, kind] for kind, form in enumerate(best)])
        return Score(rows, min(each.lit for each in found), min(each.lit_square for each in found))

    def safest(self, level: int, asked: Sequence[Score]) -> str:
        """The candidate that comes nearest to what is asked for at a level, and goes beyond, as fitted to."""
        index = 2 * level
        return min(self._candidates, key=lambda name: _cost(self._found[name, 0][index], asked[index]))

    def mixture(self, weights: NDArray[np.float32], safe: str, share: float) -> dict[str, Array]:
        """Names and (C,) weights of what a level is summed from."""
        target = MODELS[self.problem.target]
        out: dict[str, Array] = {}
        if share < 1:
            out[safe] = np.full(target.channels, 1 - share)
        if share > 0:
            count, own = len(self.others), np.full(target.channels, share)
            for k, name in enumerate(self.others):
                part = np.zeros(target.channels)
                for index, channels in enumerate(target.maps.values()):
                    part[channels] = share * weights[index * count + k]
                if part.any():
                    out[name] = out.get(name, 0) + part
                    own -= part
            out[self.base] = out.get(self.base, 0) + own
        return out

    def mixed(self, mixtures: Sequence[Mapping[str, Array]]) -> list[Image]:
        """The levels of mixtures, one each."""
        target = self.problem.target
        shapes = [(*size, MODELS[target].channels) for size in self.problem.sizes]
        out = [np.zeros(shape, np.float32) for shape in shapes]
        for name in dict.fromkeys(name for mixture in mixtures for name in mixture):
            levels = self.levels(name)
            for level, mixture in enumerate(mixtures):
                if name in mixture:
                    out[level] += levels[level] * mixture[name].astype(np.float32)
        out = [material.regularise(level, target) for level in out]
        return material.align_directions(out) if target == "gltf-anisotropic" else out


def blended(base: Image, others: Sequence[Image], weights: NDArray[np.float32], model: str) -> Image:
    """(..., C) the blend that weights of level_fit.columns stand for, before it is made valid."""
    out: Image = base.copy()
    for index, channels in enumerate(MODELS[model].maps.values()):
        for k, other in enumerate(others):
            weight = weights[index * len(others) + k]
            if weight:
                out[..., channels] += weight * (other[..., channels] - base[..., channels])
    return out


def mean(seen: Sequence[Image]) -> Image:
    """What a lookup halfway between levels, or at one, makes of lookups in each."""
    return seen[0] if len(seen) == 1 else np.asarray((seen[0] + seen[1]) / 2, np.float32)


def _cost(score: Score, asked: Score) -> float:
    """Logarithms of errors, and those behind what is asked for several times."""
    logs = np.append(score.log_errors.mean(1), score.lit_square)
    behind = logs - np.append(asked.log_errors.mean(1), asked.lit_square)
    return float((logs + _WORSE * np.maximum(behind, 0)).sum())


def _fitted(bench: _Bench, train: Scores, asked: Sequence[Score]) -> list[NDArray[np.float32]]:
    """Weights of every level."""
    from mipbake.prefilter.level_fit import Term, columns, fit_level

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
    bench: _Bench,
    judge: Scores,
    weights: Sequence[NDArray[np.float32]],
    safe: Sequence[str],
    rivals: Sequence[Sequence[Rival]],
    lit: Sequence[float],
) -> list[float]:
    """Of each level the share of its blend against its safe candidate, so that no rival is ahead beyond chance."""
    target = bench.problem.target

    def texels(index: int, level: int, share: float) -> Image:
        if share == 1:
            return bench.fitted(1, index, level, weights[level])
        own = bench.seen(safe[level], 1, index, level)
        if share == 0:
            return own
        return material.regularise(own + np.float32(share) * (texels(index, level, 1.0) - own), target)

    return settle(judge, texels, len(safe), rivals, lit)


def settle(
    judge: Scores,
    texels: Callable[[int, int, float], Image],
    levels: int,
    rivals: Sequence[Sequence[Rival]],
    lit: Sequence[float],
    slack: float = 0.25,
) -> list[float]:
    """Shares of levels, 1 where nothing speaks against it.

    Args:
        texels: of a probe's index, a level and a share, the (N, C) lookups.
        levels: how many there are.
        rivals, lit: as Blend has them. slack: logarithm of squares by which lit may be exceeded.
    """
    shares = [1.0] * levels

    def score(index: int) -> Score:
        return judge.of(mean([texels(index, level, shares[level]) for level in judge.probes[index].levels]), index)

    def behind(found: Score, index: int) -> Array:
        """By how much each rival, and the last one under the studio's lights, is ahead beyond what chance may do."""
        lost = np.stack([row - rival.log_errors for row, rival in zip(found.log_errors, rivals[index], strict=True)])
        return np.append(lost.mean(1) - _CHANCE * standard_error(lost) - _TIE, found.lit_square - lit[index] - slack)

    def cost(found: Score, index: int) -> float:
        gained = found.log_errors.mean(1).sum() + found.lit_square
        return float(gained + _WORSE * np.maximum(behind(found, index), 0).sum())

    now = [score(index) for index in range(len(judge.probes))]
    for _ in range(2):
        worst = sorted(range(len(now)), key=lambda each: -behind(now[each], each).max())
        for index in (each for each in worst if behind(now[each], each).max() > 0):
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
    """Of means over the last axis."""
    return np.asarray(values.std(-1) / np.sqrt(max(1, values.shape[-1] - 1)))
