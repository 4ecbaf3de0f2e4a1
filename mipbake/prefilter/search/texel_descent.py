"""Gauss-Newton descent on the texels of a stack (methods.py says what for).

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

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.judging.held_out import HeldOut
from mipbake.judging.lit_renders import display_slope, displayed
from mipbake.judging.scores import spoken_snr
from mipbake.judging.weights import DESCENT
from mipbake.prefilter.base import Progress, say
from mipbake.prefilter.search.budget import Budget
from mipbake.prefilter.search.lit_samples import LitBatch, lit_pixels
from mipbake.prefilter.search.lookups import Lookups
from mipbake.prefilter.search.pair_weights import PairWeights
from mipbake.prefilter.search.pixel_samples import Batch, Lobes, common_pairs, own_pairs, targets
from mipbake.prefilter.search.texel_coordinates import Crop, at_limits, per_coordinate, units, without_heights
from mipbake.reference.problem import Image, Problem, Region
from mipbake.shading import shade
from mipbake.shading.adjoint import shade_adjoint

CHECK = 5
"""Rounds between two looks at held-out pairs."""

_LIT_PIXELS = 1024  # pixels of a level and round, at least
_CONVERGED_DB = 0.02  # gain between two looks from which a level counts as moving
_OWN_PAIRS = 3  # levels whose pixels have pairs of their own
_COMMON, _COMMON_PIXELS = 4, 2048  # times as many common pairs, at most; where pixels are more than this, fewer
_LEAST_PIXELS = 128  # pixels of a level and round: the coarsest levels have a texel or two
_MEMORY, _MOST_MEMORY = 0.5, 30.0  # rounds of curvature that hold texels: grows by so many a round
_RECENT = 3.0  # in the average over rounds, the last round counts (_RECENT + 1) / (_RECENT + rounds)
_DAMPING, _ABSOLUTE = 0.02, 1e-3  # Levenberg-Marquardt: of a texel's own curvature, and of the level's mean
_TEXELS = 2048  # texels whose equations are solved at a time: they stay in the cache
_STRIDE = 2  # one in so many pairs takes part in curvature after the first round


@dataclass
class _State:
    """State of the texels of a level between rounds."""

    held: Tensor | None = None  # (h, w, P, P) curvature of past rounds
    mean: Tensor | None = None  # (h, w, P)


class Descent:
    """What regions are optimised for, and how.

    Args:
        moving: whether the texels of each level may move.
        budget: effort on a region.
        trust: how many rounds of evidence the start is worth: it holds texels as so many past rounds would.
    """

    def __init__(self, problem: Problem, moving: Sequence[bool], budget: Budget, trust: float = 0.0) -> None:
        self.problem, self.moving, self.budget, self.trust = problem, moving, budget, trust
        self.lobes = Lobes.under(problem)


def descend(
    descent: Descent,
    levels: list[Image],
    block: Region,
    rng: np.random.Generator,
    deadline: float = math.inf,
    progress: Progress = lambda _: None,
) -> int:
    """Optimises the texels of a block and writes the best that held-out pixels of the block saw into `levels`.

    Args:
        levels: (H_L, W_L, C) the stack, changed in place inside the block.
        deadline: time.monotonic() after which no round begins.
        progress: where it takes notes, it is told the SNR on held-out pairs at each look.

    Returns:
        The rounds that were worked.
    """
    problem, moving, budget, lobes = descent.problem, descent.moving, descent.budget, descent.lobes
    near = range(max(0, block.levels.start - 1), min(len(levels), block.levels.stop + 1))
    crops = {i: Crop(levels[i], block, problem.target, problem.wrap, i in block.levels and moving[i]) for i in near}
    free = {i: crop for i, crop in crops.items() if crop.free}
    for crop in free.values():
        crop.move(crop.coordinates)
    held_out = HeldOut(problem, block, budget.held_out, [int(rng.integers(1 << 31))])
    weights = PairWeights(held_out, lobes[-1].levels[-1][0, 0], held_out.typical(levels))
    states = {i: _State() for i in free}
    best = {i: levels[i][crop.window].copy() for i, crop in free.items()}
    last = weights.update(levels)
    least, still, began = last.mean(), 0, time.monotonic()
    done, asked_lit = 0, dict[int, float]()
    seed = int(rng.integers(1 << 31))

    def draw(turn: int) -> tuple[list[tuple[Batch, Image]], list[LitBatch]]:
        return _draw(problem, crops, free, weights, lobes, block, budget, turn, np.random.default_rng([seed, turn]))

    # What a round is fitted to does not hang on where the texels are: it is drawn while the last one is worked on.
    with ThreadPoolExecutor(1) as ahead_of_time:
        drawn = ahead_of_time.submit(draw, 0) if free and budget.rounds else None
        while drawn is not None:
            started = time.monotonic()
            renders, lit = drawn.result()
            more = done + 1 < budget.rounds and started < deadline
            drawn = ahead_of_time.submit(draw, done + 1) if more else None
            round_ = _Drawn.of(crops, renders, weights, lit)
            _round(problem.target, free, states, round_, asked_lit, budget.steps, done, descent.trust, rng)
            del round_
            del renders, lit
            done += 1
            finished = time.monotonic()
            # Half a round late is no later on average than half a round early.
            late = finished + (finished - started) / 2 > deadline
            progress(min(1.0, max(done / budget.rounds, (finished - began) / max(1e-9, deadline - began))))
            if done % CHECK and drawn is not None and not late:
                continue
            for i, crop in free.items():
                mean = states[i].mean
                assert mean is not None
                levels[i][crop.window] = crop.values(mean)
            now = weights.update(levels)
            say(progress, spoken_snr(-10 / math.log(10) * now.mean(1)))
            gains = _per_level(last - now, block, held_out.lods)
            last = now
            if now.mean() < least:
                least, best = now.mean(), {i: levels[i][crop.window].copy() for i, crop in free.items()}
            still = still + 1 if (gains < _CONVERGED_DB).all() else 0
            if still == 2 or late:
                if drawn is not None:
                    drawn.cancel()
                break
    for i, crop in free.items():
        levels[i][crop.window] = best[i]
    return done


def _per_level(gains: NDArray[np.float64], block: Region, lods: Sequence[float]) -> NDArray[np.float64]:
    """(levels,) decibels of (S, M) logarithms: means over pair sets and the levels of detail within 1/2."""
    near = [np.abs(np.array(lods) - level) <= 0.5 for level in block.levels]
    return 10 / math.log(10) * np.array([gains[:, each].mean() for each in near])


def _draw(
    problem: Problem,
    crops: dict[int, Crop],
    free: dict[int, Crop],
    weights: PairWeights,
    lobes: Sequence[Lobes],
    block: Region,
    budget: Budget,
    turn: int,
    rng: np.random.Generator,
) -> tuple[list[tuple[Batch, Image]], list[LitBatch]]:
    """The batches of a round, with (K, P, 3) estimates of the reference."""
    out, lit = list[tuple[Batch, Image]](), list[LitBatch]()
    for level in block.levels:
        uv = crops[level].pixels(_LEAST_PIXELS, rng)
        if level < _OWN_PAIRS:
            batches = own_pairs(problem, lobes, level, uv, budget.pairs, turn, rng)
        else:
            times = max(1, min(_COMMON, _COMMON_PIXELS // len(uv)))
            batches = common_pairs(problem, weights.pairs, level, uv, times * budget.pairs, rng)
        for batch in batches:
            if any(index in free for index, _ in batch.seen):
                out.append((replace(batch, pixels=len(uv)), targets(problem, batch, budget.samples, rng)))
        if budget.lit:
            lit += lit_pixels(problem, level, crops[level].pixels(_LIT_PIXELS, rng), budget.samples, rng)
    return out, [batch for batch in lit if any(index in free for index, _ in batch.seen)]


@dataclass(frozen=True)
class _Drawn:
    """What a round is fitted to.

    Args:
        renders: batches, (K, P, 3) estimates of the reference, and (K, P) what the squared error of each render counts.
        lit: batches under the studio's lights. lookups: of all pixels, renders first.
    """

    renders: list[tuple[Batch, Image, Image]]
    lit: list[LitBatch]
    lookups: Lookups

    @classmethod
    def of(
        cls,
        crops: dict[int, Crop],
        renders: Sequence[tuple[Batch, Image]],
        weights: PairWeights,
        lit: list[LitBatch],
    ) -> _Drawn:
        weighed = [(batch, target, (weights.of(batch) / batch.pixels).numpy()) for batch, target in renders]
        return cls(weighed, lit, Lookups(crops, [*(batch for batch, _ in renders), *lit]))


def _round(
    model: str,
    free: dict[int, Crop],
    states: dict[int, _State],
    drawn: _Drawn,
    asked_lit: dict[int, float],
    steps: int,
    turn: int,
    trust: float,
    rng: np.random.Generator,
) -> None:
    """One round on its batches: curvature where the texels are, then steps."""
    texels = drawn.lookups.texels()
    lit_weights = _lit_weights(drawn.lit, texels[len(drawn.renders) :], asked_lit, model)
    curvature = _curvature(model, free, drawn, texels, lit_weights, turn, rng)
    for i, state in states.items():
        if state.held is None and trust:
            state.held, state.mean = _MEMORY * trust * curvature[i], free[i].coordinates
    systems = {i: _System(crop, curvature[i], states[i].held) for i, crop in free.items()}
    for step in range(steps):
        rows = _gradients(model, drawn, drawn.lookups.texels() if step else texels, lit_weights)
        for i, crop in free.items():
            by_texel = drawn.lookups.scattered(i, rows)
            if by_texel is not None:
                crop.move(systems[i].stepped(crop.coordinates, crop.gradient(by_texel)))
    age = turn + trust
    memory = 1 - 1 / min(1 + _MEMORY * age, _MOST_MEMORY)
    for i, state in states.items():
        state.held = memory * (curvature[i] if state.held is None else state.held + curvature[i])
        here = free[i].coordinates
        state.mean = here if state.mean is None else state.mean.lerp(here, (_RECENT + 1) / (_RECENT + age + 1))


def _gradients(
    model: str, drawn: _Drawn, texels: Sequence[Image], lit_weights: dict[int, float]
) -> list[NDArray[np.float32]]:
    """(P, C) of each batch: gradients of half the weighted squared errors by what its pixels see."""
    rows = []
    for (batch, target, weight), seen in zip(drawn.renders, texels, strict=False):
        light, view = batch.light.numpy()[None], batch.view.numpy()[None]
        off = shade(model, seen[None], light, view)
        off -= target
        off *= weight[..., None]
        rows.append(shade_adjoint(model, seen[None], light, view, off)[0])
    for lit, seen in zip(drawn.lit, texels[len(drawn.renders) :], strict=True):
        radiance = lit.radiance(seen, model)
        off = (displayed(radiance) - lit.target) * display_slope(radiance)
        rows.append(lit.adjoint(seen, model, np.float32(lit_weights[lit.level]) * off))
    return rows


def _lit_weights(
    lit: Sequence[LitBatch], texels: Sequence[Image], asked: dict[int, float], model: str
) -> dict[int, float]:
    """What the squared error of a lit pixel counts at each level; the first round's are asked for later on."""
    sums: dict[int, list[float]] = {}
    for batch, seen in zip(lit, texels, strict=True):
        square = np.square(displayed(batch.radiance(seen, model)) - batch.target).sum()
        each = sums.setdefault(batch.level, [0.0, 0.0])
        each[0], each[1] = each[0] + float(square), each[1] + batch.target.size
    out = {}
    for level, (total, count) in sums.items():
        error = max(total / count, 1e-7)
        behind = error > DESCENT.lit_slack * asked.setdefault(level, error)
        out[level] = (DESCENT.lit + DESCENT.lit_behind * behind) / (error * count)
    return out


def _curvature(
    model: str,
    free: dict[int, Crop],
    drawn: _Drawn,
    texels: Sequence[Image],
    lit_weights: dict[int, float],
    turn: int,
    rng: np.random.Generator,
) -> dict[int, Tensor]:
    """(h, w, P, P) of each level: sum over pixels of share times J^T w J, with J the derivative by its coordinates.

    Of the three colour channels of a render a combination with random signs is differentiated: over many renders, the
    mean of (J^T s)(J^T s)^T is J^T J.
    """
    stride = _STRIDE if turn else 1
    some = slice(turn % stride, None, stride)
    packed = []
    for (batch, _, weight), seen in zip(drawn.renders, texels, strict=False):
        signs = _signs((len(weight[some]), *weight.shape[1:], 3), rng)
        signs *= np.sqrt(stride * weight[some])[..., None]
        light, view = (d.numpy()[some, None] for d in (batch.light, batch.view))
        by_pair = shade_adjoint(model, np.broadcast_to(seen, (len(signs), *seen.shape)), light, view, signs)
        rows = without_heights(torch.from_numpy(by_pair), torch.from_numpy(seen), model).permute(1, 2, 0)
        packed.append(_packed(torch.bmm(rows, rows.transpose(1, 2))))
    for lit, seen in zip(drawn.lit, texels[len(drawn.renders) :], strict=True):
        signs = _signs((len(seen), 3), rng) * display_slope(lit.radiance(seen, model))
        by_pixel = lit.adjoint(seen, model, np.float32(math.sqrt(lit_weights[lit.level])) * signs)
        rows = without_heights(torch.from_numpy(by_pixel), torch.from_numpy(seen), model)
        packed.append(_packed(rows[:, :, None] * rows[:, None, :]))
    out = {}
    for i, crop in free.items():
        scale = per_coordinate(crop.coordinates, model)
        size = scale.shape[-1]
        full = torch.zeros(*scale.shape, size)
        summed = drawn.lookups.scattered(i, packed)
        if summed is not None:
            inside = torch.from_numpy(summed[crop.rows.inside, crop.columns.inside])
            upper = torch.triu_indices(size, size)
            full[..., upper[0], upper[1]] = inside
            full[..., upper[1], upper[0]] = inside
        out[i] = full * scale[..., :, None] * scale[..., None, :]
    return out


def _packed(grams: Tensor) -> Image:
    """(P, D (D + 1) / 2): the upper halves of (P, D, D) symmetric matrices."""
    upper = torch.triu_indices(*grams.shape[1:])
    return np.asarray(grams[:, upper[0], upper[1]].numpy())


def _signs(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    return np.asarray(2 * rng.integers(0, 2, shape, np.int8) - 1, np.float32)


class _System:
    """The equations of a round for the texels of a level: what a gradient is divided by, what holds texels in place.

    Args:
        own, held: (h, w, P, P) curvature of this round and of past ones.
    """

    def __init__(self, crop: Crop, own: Tensor, held: Tensor | None) -> None:
        self._model, self._start = crop.model, crop.coordinates.flatten(0, 1)
        self._own, self._held = own.flatten(0, 1), None if held is None else held.flatten(0, 1)
        self._unit = units(self._start, self._model)
        diagonal = self._own.diagonal(dim1=-2, dim2=-1)
        if self._held is not None:
            diagonal = diagonal + self._held.diagonal(dim1=-2, dim2=-1)
        self._least = _ABSOLUTE * (diagonal * self._unit.square()).mean(0) + 1e-12
        self._factors: list[tuple[Tensor, Tensor]] = []

    def stepped(self, here: Tensor, gradient: Tensor) -> Tensor:
        """(h, w, P) coordinates a step from `here`, none of them farther than a unit.

        A coordinate at a limit that the first step would lead it out of stays where it is for all of the round.
        """
        flat, slopes = here.flatten(0, 1), gradient.flatten(0, 1)
        out = torch.empty_like(flat)
        first = not self._factors
        for index, begin in enumerate(range(0, len(flat), _TEXELS)):
            some = slice(begin, begin + _TEXELS)
            unit, pull = self._unit[some], slopes[some]
            if first:
                self._factors.append(self._factor(some, at_limits(flat[some], pull, self._model)))
            elif self._held is not None:
                pull = pull + (self._held[some] @ (flat[some] - self._start[some])[..., None])[..., 0]
            factor, free = self._factors[index]
            step = torch.cholesky_solve((pull * unit * free)[..., None], factor)[..., 0].nan_to_num(0, 0, 0)
            out[some] = flat[some] - unit * step / step.abs().amax(-1, keepdim=True).clamp(min=1)
        return out.reshape(here.shape)

    def _factor(self, some: slice, fixed: Tensor) -> tuple[Tensor, Tensor]:
        """The Cholesky factors of some texels in units, and 1 for the coordinates that are free in them, else 0."""
        free = 1 - fixed.to(self._unit.dtype)
        matrix = self._own[some] if self._held is None else self._own[some] + self._held[some]
        scale = self._unit[some] * free
        matrix = matrix * scale[..., :, None] * scale[..., None, :]
        diagonal = matrix.diagonal(dim1=-2, dim2=-1)
        diagonal += _DAMPING * diagonal + self._least * free + (1 - free)
        factor, _ = torch.linalg.cholesky_ex(matrix)
        return factor, free
