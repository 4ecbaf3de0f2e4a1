"""Descent on the texels of a stack (methods.py says what for).

A round draws pixels, pairs and estimates of the reference anew (pixel_samples.py) and takes a few steps on them. Each
texel is divided by a curvature matrix of its own: the Gauss-Newton matrices of all pixels that look it up, each
weighted by the texel's share in the lookup. Shares sum to 1, so by Jensen's inequality these blocks bound the coupled
matrix from above: all texels step at once without overshooting.

The noise of a round is averaged in two ways. Curvature of past rounds holds texels where they are, as in recursive
least squares, so steps shrink like 1 / rounds; and what is kept is an average over rounds, later ones counting more.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.judging.judge import Asked, Judge
from mipbake.judging.scores import Errors, Scores, spoken_snr
from mipbake.judging.weights import SINGLE_LIGHTS, Weights
from mipbake.prefilter.base import Progress, say
from mipbake.prefilter.search.crops import Crop
from mipbake.prefilter.search.descent_effort import DescentEffort
from mipbake.prefilter.search.gauss_newton import System, signs
from mipbake.prefilter.search.lookups import Lookups
from mipbake.prefilter.search.pair_weights import PairWeights
from mipbake.prefilter.search.picture_samples import PictureChunk, picture_chunks, picture_slopes, texels_around
from mipbake.prefilter.search.pixel_samples import Chunk, Lobes, common_pairs, estimates, own_pairs
from mipbake.prefilter.search.texel_coordinates import limits, per_coordinate, units, without_heights
from mipbake.reference.problem import Image, Problem, Region
from mipbake.shading import shade
from mipbake.shading.adjoint import shade_adjoint

CHECK = 5
"""Rounds between two looks at what the stack is worth. A guess."""

_PICTURES = 16  # of a level and round; a guess
_CONVERGED = 0.01  # nepers gained between two looks from which a level counts as moving; a guess
_OWN_PAIRS = 3  # levels whose pixels have pairs of their own; a guess
# Times as many common pairs, at most; where pixels are more than this, fewer; a guess.
_COMMON, _COMMON_PIXELS = 4, 2048
_LEAST_PIXELS = 128  # pixels of a level and round: the coarsest levels have a texel or two; a guess
_MEMORY, _MOST_MEMORY = 0.5, 30.0  # rounds of curvature that hold texels: grows by so many a round; a guess
_RECENT = 3.0  # in the average over rounds, the last round counts (_RECENT + 1) / (_RECENT + rounds); a guess
_DAMPING = 0.02  # in units of a texel's own curvature; a guess
_STRIDE = 2  # one in so many pairs takes part in curvature after the first round; a guess


@dataclass
class _State:
    """State of the texels of a level between rounds."""

    held: Image | None = None  # (h, w, P, P) curvature of past rounds
    mean: Image | None = None  # (h, w, P)


class Descent:
    """What regions are optimised for, and how.

    Args:
        moving: whether the texels of each level may move.
        effort: effort on a region.
        trust: how many rounds of evidence the start is worth: it holds texels as so many past rounds would.
        judged_by: what errors count.
        typical: (C,) stored channels of the model PLAIN that shade about as bright as the whole set; None for the mean
            of the wide lobes.
    """

    def __init__(
        self,
        problem: Problem,
        moving: Sequence[bool],
        effort: DescentEffort,
        trust: float = 0.0,
        judged_by: Weights = SINGLE_LIGHTS,
        typical: Image | None = None,
    ) -> None:
        self.problem, self.moving, self.effort, self.trust = problem, moving, effort, trust
        self.judged_by = judged_by
        self._typical = typical

    @cached_property
    def lobes(self) -> list[Lobes]:
        """What half vectors of fine levels are drawn from: stacks, which coarse levels do without."""
        return Lobes.under(self.problem)

    @property
    def typical(self) -> Image:
        """(C,) stored channels of PLAIN that shade about as bright as the whole set."""
        return self.lobes[-1].levels[-1][0, 0] if self._typical is None else self._typical


def descend(
    descent: Descent,
    levels: list[Image],
    region: Region,
    rng: np.random.Generator,
    deadline: float = math.inf,
    progress: Progress = lambda _: None,
) -> int:
    """Optimises the texels of a region, until looks at other renders of it see no gain.

    Args:
        levels: (H_L, W_L, C) the stack, changed in place inside the region.
        deadline: time.monotonic() after which no round begins.
        progress: where it takes notes, it is told the SNR at each look.

    Returns:
        The rounds that were worked.
    """
    problem, moving, effort = descent.problem, descent.moving, descent.effort
    near = range(max(0, region.levels.start - 1), min(len(levels), region.levels.stop + 1))
    crops = {
        i: Crop(levels[i], region, problem, i in region.levels and moving[i], texels_around(problem, region, i))
        for i in near
    }
    free = {i: crop for i, crop in crops.items() if crop.free}
    for crop in free.values():
        crop.move(crop.coordinates)
    scores = _looks(problem, region, effort, int(rng.integers(1 << 31)))
    errors = scores.stack_errors(levels)
    judge = Judge([Asked.of(each.score) for each in errors], descent.judged_by)
    weights = PairWeights(scores, judge, descent.typical)
    weights.update(errors)
    states = {i: _State() for i in free}
    last = _values(judge, errors)
    least, best = last.sum(), _within(levels, free)
    done, still, began, seed = 0, 0, time.monotonic(), int(rng.integers(1 << 31))

    def draw(turn: int) -> tuple[list[tuple[Chunk, Image]], list[PictureChunk]]:
        return _draw(descent, crops, weights, region, turn, np.random.default_rng([seed, turn]))

    # What a round is fitted to does not hang on where the texels are: it is drawn while the last one is worked on.
    with ThreadPoolExecutor(1) as ahead_of_time:
        drawn = ahead_of_time.submit(draw, 0) if free and effort.rounds else None
        while drawn is not None:
            started = time.monotonic()
            renders, pictures = drawn.result()
            more = done + 1 < effort.rounds and started < deadline
            drawn = ahead_of_time.submit(draw, done + 1) if more else None
            round_ = _Drawn.of(crops, renders, weights, pictures)
            _round(descent, free, states, round_, done, rng)
            del round_
            del renders, pictures
            done += 1
            finished = time.monotonic()
            # Half a round late is no later on average than half a round early.
            late = finished + (finished - started) / 2 > deadline
            progress(min(1.0, max(done / effort.rounds, (finished - began) / max(1e-9, deadline - began))))
            if done % CHECK and drawn is not None and not late:
                continue
            for i, crop in free.items():
                mean = states[i].mean
                assert mean is not None
                levels[i][crop.window] = crop.values(mean)
            errors = scores.stack_errors(levels)
            weights.update(errors)
            now = _values(judge, errors)
            say(progress, spoken_snr(np.mean([each.score.decibels for each in errors], 0)))
            gains = _per_level(last - now, region, scores.lods)
            last = now
            if now.sum() < least:
                least, best = now.sum(), _within(levels, free)
            still = still + 1 if (gains < _CONVERGED).all() else 0
            if still == 2 or late:
                if drawn is not None:
                    drawn.cancel()
                break
    # Where the last rounds lost more than they gained, the texels are as the best look found them.
    for i, crop in free.items():
        levels[i][crop.window] = best[i]
    return done


def _within(levels: Sequence[Image], free: dict[int, Crop]) -> dict[int, Image]:
    """Copies of what crops hold of each level."""
    return {i: levels[i][crop.window].copy() for i, crop in free.items()}


def _looks(problem: Problem, region: Region, effort: DescentEffort, seed: int) -> Scores:
    """Renders of a region, at the levels of detail of its levels and half a level further."""
    lods = [level + half for level in region.levels for half in (0.0, 0.5) if level + half <= problem.last]
    return Scores(problem, effort.looks, [seed], lods, region)


def _values(judge: Judge, errors: Sequence[Errors]) -> NDArray[np.float64]:
    """(M,) what a stack is worth at each level of detail."""
    return np.array([judge.value(each.score, index) for index, each in enumerate(errors)])


def _per_level(gains: NDArray[np.float64], region: Region, lods: Sequence[float]) -> NDArray[np.float64]:
    """(levels,) means of (M,) nepers over the levels of detail within 1/2."""
    near = [np.abs(np.array(lods) - level) <= 0.5 for level in region.levels]
    return np.array([gains[each].mean() for each in near])


def _draw(
    descent: Descent,
    crops: dict[int, Crop],
    weights: PairWeights,
    region: Region,
    turn: int,
    rng: np.random.Generator,
) -> tuple[list[tuple[Chunk, Image]], list[PictureChunk]]:
    """The chunks of a round, with (K, P, 3) estimates of the reference."""
    problem, effort = descent.problem, descent.effort
    free = {i for i, crop in crops.items() if crop.free}
    out, pictures = list[tuple[Chunk, Image]](), list[PictureChunk]()
    for level in region.levels:
        uv = crops[level].pixels(_LEAST_PIXELS, rng)
        if level < _OWN_PAIRS:
            chunks = own_pairs(problem, descent.lobes, level, uv, effort.pairs, turn, rng)
        else:
            times = max(1, min(_COMMON, _COMMON_PIXELS // len(uv)))
            chunks = common_pairs(problem, weights.pairs(level), level, uv, times * effort.pairs, rng)
        for chunk in chunks:
            if any(index in free for index, _ in chunk.seen):
                out.append((replace(chunk, pixels=len(uv)), estimates(problem, chunk, effort.samples, rng)))
        pictures += picture_chunks(problem, region, level, _PICTURES, effort.samples, rng)
    return out, [chunk for chunk in pictures if any(index in free for index, _ in chunk.seen)]


@dataclass(frozen=True)
class _Drawn:
    """What a round is fitted to.

    Args:
        renders: chunks, (K, P, 3) estimates of the reference, and (K, P) what the squared error of each render counts.
        pictures: chunks of small pictures. seen_counts: by level, (V,) what the visible error of each kind
            counts.
        lookups: of all pixels, renders first.
    """

    renders: list[tuple[Chunk, Image, Image]]
    pictures: list[PictureChunk]
    seen_counts: dict[int, NDArray[np.float64]]
    lookups: Lookups

    @classmethod
    def of(
        cls,
        crops: dict[int, Crop],
        renders: Sequence[tuple[Chunk, Image]],
        weights: PairWeights,
        pictures: list[PictureChunk],
    ) -> _Drawn:
        weighed = [(chunk, estimate, weights.of(chunk) / np.float32(chunk.pixels)) for chunk, estimate in renders]
        counts = {chunk.level: weights.seen(chunk.level) for chunk in pictures}
        return cls(weighed, pictures, counts, Lookups(crops, [*(chunk for chunk, _ in renders), *pictures]))


def _round(
    descent: Descent,
    free: dict[int, Crop],
    states: dict[int, _State],
    drawn: _Drawn,
    turn: int,
    rng: np.random.Generator,
) -> None:
    """One round on its chunks: curvature where the texels are, then steps."""
    model, trust = descent.problem.target, descent.trust
    texels = drawn.lookups.texels()
    curvature = _curvature(model, free, drawn, texels, turn, rng)
    for i, state in states.items():
        if state.held is None and trust:
            state.held, state.mean = _MEMORY * trust * curvature[i], free[i].coordinates
    systems = {i: _system(crop, curvature[i], states[i].held) for i, crop in free.items()}
    for step in range(descent.effort.steps):
        rows = _gradients(model, drawn, drawn.lookups.texels() if step else texels)
        for i, crop in free.items():
            by_texel = drawn.lookups.scattered(i, rows)
            if by_texel is not None:
                here, slope = (_flat(each) for each in (crop.coordinates, crop.gradient(by_texel)))
                crop.move(systems[i].stepped(here, slope).reshape(crop.coordinates.shape))
    age = turn + trust
    memory = 1 - 1 / min(1 + _MEMORY * age, _MOST_MEMORY)
    for i, state in states.items():
        state.held = memory * (curvature[i] if state.held is None else state.held + curvature[i])
        here = free[i].coordinates
        weight = (_RECENT + 1) / (_RECENT + age + 1)
        state.mean = here if state.mean is None else state.mean + weight * (here - state.mean)


def _gradients(model: str, drawn: _Drawn, texels: Sequence[Image]) -> list[NDArray[np.float32]]:
    """(P, C) of each chunk: half the gradients of what is minimised by what its pixels see."""
    rows = []
    for (chunk, estimate, weight), seen in zip(drawn.renders, texels, strict=False):
        light, view = chunk.light[None], chunk.view[None]
        off = shade(model, seen[None], light, view)
        off -= estimate
        off *= weight[..., None]
        rows.append(shade_adjoint(model, seen[None], light, view, off)[0])
    others = texels[len(drawn.renders) :]
    found = picture_slopes(drawn.pictures, others, model, drawn.seen_counts)
    for picture, seen, slopes in zip(drawn.pictures, others, found, strict=True):
        rows.append(picture.adjoint(model, seen, slopes.by_radiance))
    return rows


def _curvature(
    model: str,
    free: dict[int, Crop],
    drawn: _Drawn,
    texels: Sequence[Image],
    turn: int,
    rng: np.random.Generator,
) -> dict[int, Image]:
    """(h, w, P, P) of each level: sum over pixels of share times J^T w J, with J the derivative by its coordinates.

    Of the three colour channels of a render a combination with random signs is differentiated: over many renders, the
    mean of (J^T s)(J^T s)^T is J^T J.
    """
    stride = _STRIDE if turn else 1
    some = slice(turn % stride, None, stride)
    packed = []
    for (chunk, _, weight), seen in zip(drawn.renders, texels, strict=False):
        turned = signs((len(weight[some]), *weight.shape[1:], 3), rng)
        turned *= np.sqrt(stride * weight[some])[..., None]
        light, view = (d[some, None] for d in (chunk.light, chunk.view))
        by_pair = shade_adjoint(model, np.broadcast_to(seen, (len(turned), *seen.shape)), light, view, turned)
        packed.append(_packed(without_heights(by_pair, seen, model)))
    others = texels[len(drawn.renders) :]
    found = picture_slopes(drawn.pictures, others, model, drawn.seen_counts)
    for picture, seen, slopes in zip(drawn.pictures, others, found, strict=True):
        # The lookups of a pixel have equal shares in it, which sum to 1.
        by_lookup = picture.adjoint(model, seen, slopes.combinations(rng)) * np.float32(np.sqrt(picture.lookups))
        packed.append(_packed(without_heights(by_lookup, seen, model)[None]))
    out = {}
    for i, crop in free.items():
        scale = per_coordinate(crop.coordinates, model)
        size = scale.shape[-1]
        full = np.zeros((*scale.shape, size), np.float32)
        summed = drawn.lookups.scattered(i, packed)
        if summed is not None:
            inside = summed[crop.rows.inside, crop.columns.inside]
            upper = np.triu_indices(size)
            full[..., upper[0], upper[1]] = inside
            full[..., upper[1], upper[0]] = inside
        full *= scale[..., :, None]
        full *= scale[..., None, :]
        out[i] = full
    return out


def _packed(rows: Image) -> Image:
    """(P, D (D + 1) / 2): the upper halves of the sums over K of the squares v v^T of (K, P, D) vectors v."""
    turned = np.ascontiguousarray(np.moveaxis(rows, -1, 0))
    first, second = np.triu_indices(len(turned))
    out = np.empty((rows.shape[1], len(first)), np.float32)
    for index, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        out[:, index] = np.einsum("kp,kp->p", turned[i], turned[j])
    return out


def _flat(values: Image) -> Image:
    """(h w, ...) of (h, w, ...)."""
    return values.reshape(-1, *values.shape[2:])


def _system(crop: Crop, own: Image, held: Image | None) -> System:
    """The equations of the texels of a crop, of (h, w, P, P) curvatures."""
    start = _flat(crop.coordinates)
    before = None if held is None else _flat(held)
    unit, ends = units(start, crop.model), limits(start, crop.model)
    return System(start, _flat(own), before, unit, ends, _DAMPING)
