"""Descent on the texels of a stack (optimum.py says what for).

Texels move in coordinates whose unit is about as large a change everywhere: colours as they are, roughness as
ln alpha^2, normals in units of the lobe's width alpha, since what turns a mirror over is nothing to a rough surface.

Adam (Kingma and Ba 2015) divides each coordinate by its own mean gradient, so that texels that are right already walk
at random as fast as wrong ones move. Here the divisor has the mean over the level added to it: they stay.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake import material, sampling
from mipbake.metrics.pairs import PAIR_SETS, LightViewPairs
from mipbake.models import parameters
from mipbake.prefilter.base import Progress
from mipbake.prefilter.held_out import (
    Budget,
    HeldOut,
    Image,
    Problem,
    Region,
    draw_pairs,
    estimate,
    estimate_twice,
    random_points,
    samples_at,
    typical,
)
from mipbake.prefilter.pixel_filter import Wrap
from mipbake.shading.ops import shade

_COLOUR, _LOG_ALPHA2, _NORMAL, _DIRECTION, _STRENGTH = 0.004, 0.02, 0.02, 0.01, 0.004
_RATES = {
    "gltf": (_COLOUR,) * 4 + (_LOG_ALPHA2,) + (_NORMAL,) * 2,
    "gltf-anisotropic": (_COLOUR,) * 4 + (_LOG_ALPHA2,) + (_NORMAL,) * 2 + (_DIRECTION,) * 2 + (_STRENGTH,),
    "ggx": (_COLOUR,) * 6 + (_NORMAL,) * 2 + (_LOG_ALPHA2,) * 3,
}
"""Length of a first step along each coordinate."""

_NORMALS = {"gltf": slice(5, 7), "gltf-anisotropic": slice(5, 7), "ggx": slice(6, 8)}
_MEAN_DECAY, _SQUARE_DECAY = 0.9, 0.98
_LEAST_STRENGTH = 1e-3  # strength enters shading squared: from 0 itself no gradient leads away
_LEAST_ALPHA = 0.02
_POOL_POINTS = 256  # pixels that the start's errors are estimated at, for each level
_CEILING = 1e-6  # error in units of the signal below which a level counts as right
_STALLED_DB = 0.02  # a round that gains less than this on held-out pairs shrinks the steps
_SHRINK = 0.4
_RING = 4  # texels around a block that its pixels read: one of their own level, two or three of the finer one, a half
_LEAST_PIXELS = 64  # of a level and step: the coarsest levels have a texel or two


def to_coordinates(stored: Tensor, model: str) -> Tensor:
    """(..., C) valid stored channels to (..., P) parameters without constraints."""
    if model != "gltf-anisotropic":
        return parameters.to_parameters(stored, model)
    strength = stored[..., 10:11].clamp(_LEAST_STRENGTH, 1)
    return torch.cat([parameters.to_parameters(stored[..., :8], "gltf"), stored[..., 8:10], strength.square()], -1)


def to_stored(coordinates: Tensor, model: str) -> Tensor:
    """(..., P) parameters to (..., C) valid stored channels, differentiable."""
    if model != "gltf-anisotropic":
        return parameters.to_stored(coordinates, model)
    direction = coordinates[..., 7:9]
    direction = direction / direction.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
    strength = parameters.clamp(coordinates[..., 9:10], _LEAST_STRENGTH**2, 1).sqrt()
    return torch.cat([parameters.to_stored(coordinates[..., :7], "gltf"), direction, strength], -1)


def lobe_width(coordinates: Tensor, model: str) -> Tensor:
    """(..., 1) alpha, the geometric mean of both axes for `ggx`; at least 0.02, at most 1."""
    half = coordinates[..., 4:5] / 2 if model != "ggx" else (coordinates[..., 8:9] + coordinates[..., 9:10]) / 4
    return half.clamp(math.log(_LEAST_ALPHA), 0).exp()


@dataclass
class _Axis:
    """Where the free texels of a level lie along one axis, and what is around them."""

    size: int
    first: int
    last: int
    mode: str

    @classmethod
    def of(cls, size: int, low: float, high: float, mode: str) -> _Axis:
        # Rounded alike for neighbours: windows share no texel and leave none out.
        first, last = round(low * size), round(high * size)
        return cls(size, first, last, mode)

    @property
    def whole(self) -> bool:
        return self.last - self.first == self.size

    @property
    def index(self) -> NDArray[np.int64]:
        """Texels of the crop: the free ones, with a ring of more around them where the level goes on."""
        if self.whole:
            return np.arange(self.size)
        index = np.arange(self.first - _RING, self.last + _RING)
        return index % self.size if self.mode == "wrap" else np.clip(index, 0, self.size - 1)

    @property
    def inside(self) -> slice:
        """The free texels in the crop."""
        return slice(None) if self.whole else slice(_RING, -_RING)

    @property
    def boundary(self) -> str:
        return self.mode if self.whole else "clamp"

    def local(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates in units of the texture to coordinates in units of the crop."""
        ring = 0 if self.whole else _RING
        return np.asarray((u * self.size - self.first + ring) / (self.last - self.first + 2 * ring))

    def pixels(self) -> tuple[int, int]:
        """First and last cell of pixels that see free texels."""
        low, high = (self.first, self.last) if self.whole else (self.first - 1, self.last + 1)
        return (low, high) if self.mode == "wrap" else (max(low, 0), min(high, self.size))


class _Level:
    """The part of a level that a block sees, and the state of its descent."""

    def __init__(self, level: Image, region: Region, model: str, wrap: Wrap, free: bool) -> None:
        self.model = model
        self.columns = _Axis.of(level.shape[1], region.left, region.right, wrap[0])
        self.rows = _Axis.of(level.shape[0], region.top, region.bottom, wrap[1])
        self.start = torch.from_numpy(np.ascontiguousarray(level[np.ix_(self.rows.index, self.columns.index)]))
        self.now = self.start
        self.free = free and self.rows.last > self.rows.first and self.columns.last > self.columns.first
        if self.free:
            origin = to_coordinates(self.start[self.rows.inside, self.columns.inside], model)
            self.origin, self.unit = origin, torch.ones_like(origin)
            self.unit[..., _NORMALS[model]] = lobe_width(origin, model)
            self.moved = torch.zeros_like(origin, requires_grad=True)
            self.mean, self.square, self.count = torch.zeros_like(origin), torch.zeros_like(origin), 0
            self.rates = torch.tensor(_RATES[model])

    @property
    def window(self) -> tuple[slice, slice]:
        """The free texels in the level."""
        return slice(self.rows.first, self.rows.last), slice(self.columns.first, self.columns.last)

    def inside(self) -> Tensor:
        """(h, w, C) stored channels of the free texels, differentiable in `moved`."""
        return to_stored(self.origin + self.unit * self.moved, self.model)

    def values(self) -> Image:
        """(h, w, C) stored channels of the free texels, unit vectors to the last digit."""
        with torch.no_grad():
            return np.asarray(material.regularise(self.inside().numpy(), self.model), np.float32)

    def update(self) -> None:
        """Sets `now`, (h', w', C), from the coordinates."""
        if self.free:
            now = self.start.clone()
            now[self.rows.inside, self.columns.inside] = self.inside()
            self.now = now

    def look_up(self, uv: NDArray[np.float64]) -> Tensor:
        """(P, C): the level as it is now at (P, 2) uv of the texture, bilinearly."""
        where = np.stack([self.columns.local(uv[:, 0]), self.rows.local(uv[:, 1])], -1)
        return sampling.texture(
            self.now[None],
            torch.from_numpy(where.astype(np.float32))[None, None],
            filter_mode="linear",
            boundary_mode=(self.columns.boundary, self.rows.boundary),
        )[0, 0]

    def step(self, rate: float) -> None:
        """One step along the gradient of `moved`, which is cleared."""
        if not self.free or self.moved.grad is None:
            return
        grad, self.moved.grad = self.moved.grad, None
        self.count += 1
        self.mean.lerp_(grad, 1 - _MEAN_DECAY)
        self.square.lerp_(grad.square(), 1 - _SQUARE_DECAY)
        square = self.square / (1 - _SQUARE_DECAY**self.count)
        size = (square + square.sqrt().mean((0, 1)).square()).sqrt() + 1e-30
        with torch.no_grad():
            self.moved -= rate * self.rates * self.mean / (1 - _MEAN_DECAY**self.count) / size


def descend(
    problem: Problem,
    levels: list[Image],
    block: Region,
    moving: Sequence[bool],
    budget: Budget,
    rng: np.random.Generator,
    deadline: float,
    progress: Progress,
) -> int:
    """Optimises the texels of a block and writes the best that held-out pixels of the block saw into `levels`.

    Args:
        levels: (H_L, W_L, C) the stack, changed in place inside the block.
        moving: whether the texels of each level may move.
        deadline: time.monotonic() after which no step begins.

    Returns:
        The rounds worked.
    """
    near = range(max(0, block.levels.start - 1), min(len(levels), block.levels.stop + 1))
    parts = {i: _Level(levels[i], block, problem.target, problem.wrap, i in block.levels and moving[i]) for i in near}
    halves = [i + half for i in block.levels for half in (0.0, 0.5) if i + half <= len(levels) - 1]
    held_out = HeldOut(problem, block, halves, budget, [int(rng.integers(1 << 31))], 2)
    pool = _Pool(problem, levels, block, budget, rng)

    def error() -> float:
        """In decibels, the mean over pair sets and levels of detail."""
        logs = [typical(held_out.log_errors(levels, index)).mean() for index in range(len(halves))]
        return float(np.mean(logs)) * 10 / math.log(10)

    free = {i: part for i, part in parts.items() if part.free}
    best = {i: part.moved.detach().clone() for i, part in free.items()}
    before = {i: levels[i][part.window].copy() for i, part in free.items()}
    least, rate, shrunk, worked, improved = error(), 1.0, 0, 0, False
    for done in range(budget.rounds):
        for _ in range(budget.steps):
            if time.monotonic() > deadline:
                break
            _step(problem, parts, block, pool, budget, rng, rate)
        for i, part in free.items():
            levels[i][part.window] = part.values()
        worked += 1
        now = error()
        stalled = now > least - _STALLED_DB
        if now < least:
            least, best, improved = now, {i: part.moved.detach().clone() for i, part in free.items()}, True
        progress((done + 1) / budget.rounds)
        if time.monotonic() > deadline:
            break
        if stalled:
            shrunk += 1
            rate *= _SHRINK
            if shrunk > budget.shrinks:
                break
            if now > least:
                for i, part in free.items():
                    part.moved.detach().copy_(best[i])
    for i, part in free.items():
        part.moved.detach().copy_(best[i])
        levels[i][part.window] = part.values() if improved else before[i]
    return worked


class _Pool:
    """Light-view pairs to draw from, with what each weighs at each level.

    A render weighs the inverse of the start's error, its own and the mean of its pair set, so that neither the few
    pairs that have most of the error rule, nor those that have none. Errors are estimated from samples of their own.
    """

    def __init__(
        self, problem: Problem, levels: Sequence[Image], block: Region, budget: Budget, rng: np.random.Generator
    ) -> None:
        from mipbake.render import candidate

        self._pairs = draw_pairs(rng, budget.pool)
        self._each, self._drawn = budget.pool, budget.pairs // len(PAIR_SETS)
        self._weights: dict[int, NDArray[np.float64]] = {}
        for level in block.levels:
            uv = random_points(problem, block, level, _POOL_POINTS, rng)
            first, second = estimate_twice(problem, uv, level, self._pairs, budget, rng)
            shaded = candidate(levels, problem.target, problem.wrap, uv, level, self._pairs)
            error = ((shaded - first) * (shaded - second)).sum((1, 2), dtype=np.float64).reshape(-1, self._each)
            signal = (first * second).sum((1, 2), dtype=np.float64).reshape(-1, self._each)
            # Of a few pixels the product may come out below zero; and what is nearly right needs no more weight.
            error = np.maximum(error, _CEILING * signal.mean(1, keepdims=True) + 1e-12)
            self._weights[level] = (len(uv) / (error + error.mean(1, keepdims=True))).reshape(-1)

    def draw(self, rng: np.random.Generator) -> tuple[LightViewPairs, dict[int, Tensor]]:
        """Pairs of a step, the same number of each pair set, and for each level the (K,) weights of their renders."""
        kinds = range(len(PAIR_SETS))
        place = np.concatenate([k * self._each + rng.choice(self._each, self._drawn, replace=False) for k in kinds])
        weights = {level: torch.from_numpy(w[place].astype(np.float32)) for level, w in self._weights.items()}
        return LightViewPairs(self._pairs.light[place], self._pairs.view[place]), weights


def _step(
    problem: Problem,
    parts: dict[int, _Level],
    block: Region,
    pool: _Pool,
    budget: Budget,
    rng: np.random.Generator,
    rate: float,
) -> None:
    pairs, weights = pool.draw(rng)
    light, view = torch.from_numpy(pairs.light), torch.from_numpy(pairs.view)
    last = len(problem.sizes) - 1
    for part in parts.values():
        part.update()
    losses = []
    for level in block.levels:
        lod = float(np.clip(level + rng.uniform(-0.5, 0.5), 0, last))
        lower, share = min(int(lod), last), lod - int(lod)
        seen = [(parts[lower], 1 - share)] + ([(parts[lower + 1], share)] if share else [])
        if not any(part.free for part, _ in seen):
            continue
        uv = _pixels(parts[level], rng)
        texels = [part.look_up(uv) * weight for part, weight in seen]
        prediction = shade(problem.target, texels[0] if len(texels) == 1 else texels[0] + texels[1], light, view)
        target = torch.from_numpy(estimate(problem, uv, lod, pairs, 2 * samples_at(budget, lod), rng))
        losses.append(((prediction - target).square().sum((1, 2)) * weights[level]).sum() / len(uv))
    if losses:
        torch.stack(losses).sum().backward()  # type: ignore[no-untyped-call]
    for part in parts.values():
        part.step(rate)


def _pixels(part: _Level, rng: np.random.Generator) -> NDArray[np.float64]:
    """(P, 2) uv: a random place in every texel that the block sees, several where there are few."""
    (top, bottom), (left, right) = part.rows.pixels(), part.columns.pixels()
    cells = np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), -1).reshape(-1, 2)
    cells = np.tile(cells, (-(-_LEAST_PIXELS // len(cells)), 1))
    return np.asarray((cells + rng.random(cells.shape)) / [part.columns.size, part.rows.size])
