"""Measuring stacks against the reference while they are optimised: what is asked for, estimates, held-out pairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.errors import UsageError
from mipbake.metrics.pairs import PAIR_SETS, LightViewPairs, cosine_directions
from mipbake.metrics.snr import snr_from_sums, snr_sums
from mipbake.prefilter.pixel_filter import Wrap, filter_named, level_sizes
from mipbake.shading import shade

Image = NDArray[np.float32]

SET_SIZE = 64
"""Pairs of the sets that figures are quoted for (mipbake.metrics.pairs.pair_set)."""

_PIXELS_A_TEXEL, _LEAST_POINTS = 4, 128
_HELD_OUT_STREAM = 104729  # keeps these pairs apart from every set that pair_set draws
_TABLE = 1 << 14  # quantiles of the pixel filter
_RADIANCES = 1 << 17  # at a time: they stay in the cache
_SEQUENCE = np.array([0.7548776662466927, 0.5698402909980532])  # Roberts 2018: powers of 1 / plastic number


@dataclass(frozen=True)
class Budget:
    """How long to optimise; whichever ends first.

    Args:
        rounds: most rounds of a block; held-out pairs are looked at after each.
        steps: descent steps of a round. pairs: light-view pairs of a step, half of them near the mirror direction.
        shrinks: a round that no longer improves shrinks the steps so many times, then the block is done.
        samples: reference samples of a pixel of level 0; they double with each level.
        pool: light-view pairs of each set that the steps draw from.
        points: held-out pixels for each level of detail. held_out_pairs: held-out pairs of each set.
        window: blocks of large sets are at most so many texels a side.
        seconds: wall-clock limit, checked after each step; None for none. Only without one are results reproducible.
    """

    rounds: int = 30
    steps: int = 16
    pairs: int = 16
    shrinks: int = 4
    samples: int = 16
    pool: int = 1024
    points: int = 512
    held_out_pairs: int = 512
    window: int = 512
    seconds: float | None = None

    def __post_init__(self) -> None:
        least = {"rounds": 0, "steps": 1, "pairs": 2, "shrinks": 0, "samples": 2, "pool": 1, "window": 8}
        for name, low in (least | {"points": 1, "held_out_pairs": 1}).items():
            value = getattr(self, name)
            if not isinstance(value, int) or value < low:
                raise UsageError(f"{name} of the budget is {value!r}: expected a whole number from {low} up")
        for name in ("pairs", "samples"):
            if getattr(self, name) % 2:
                raise UsageError(f"{name} of the budget is {getattr(self, name)}: expected an even number")
        if self.pool < self.pairs // 2:
            raise UsageError(f"pool of the budget is {self.pool}: expected at least half of pairs, {self.pairs // 2}")
        if self.seconds is not None and not self.seconds > 0:
            raise UsageError(f"seconds of the budget is {self.seconds!r}: expected a positive number, or None")


DEFAULT_BUDGET = Budget()


@dataclass(frozen=True)
class Problem:
    """What a stack is optimised for.

    Args:
        stored: (H, W, C) stored channels of level 0 of the source, model `source`.
        target: material model of the stack.
    """

    stored: Image
    source: str
    target: str
    pixel_filter: str
    wrap: Wrap

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of every level."""
        return level_sizes(*self.stored.shape[:2])


@dataclass(frozen=True)
class Region:
    """Part of the texture in units of it, and the levels that are worked on there."""

    top: float
    bottom: float
    left: float
    right: float
    levels: range

    @property
    def origin(self) -> NDArray[np.float64]:
        """(2,) u and v of the corner."""
        return np.array([self.left, self.top])

    @property
    def extent(self) -> NDArray[np.float64]:
        """(2,) width and height."""
        return np.array([self.right - self.left, self.bottom - self.top])


class HeldOut:
    """Reference renders of held-out pairs at fixed pixels, to measure any stack by.

    The SNR of a set of pairs hangs on its few brightest, so it varies by decibels from one set of 64 to the next. So
    several sets are measured, and all their pairs together, where the brightest have most of the say.

    Args:
        region: where the pixels lie.
        lods: levels of detail, an index into which says where to measure.
        stream: of random numbers.
        part: divides the budget's points and pairs.
    """

    def __init__(
        self, problem: Problem, region: Region, lods: list[float], budget: Budget, stream: list[int], part: int = 1
    ) -> None:
        self._problem, self._lods, self._each = problem, lods, max(1, budget.held_out_pairs // part)
        rng = np.random.default_rng([_HELD_OUT_STREAM, *stream])
        self._pairs = draw_pairs(rng, self._each)
        self._renders = [
            (uv, *estimates)
            for lod in lods
            for uv in [random_points(problem, region, lod, max(1, budget.points // part), rng)]
            for estimates in [estimate_twice(problem, uv, lod, self._pairs, budget, rng)]
        ]

    def log_errors(self, levels: Sequence[Image], index: int) -> NDArray[np.float64]:
        """(S, G + 1) natural logarithm of the error relative to the signal, of pairs drawn like each of S pair sets.

        For G sets of them, and in the last column for all together. 0 where nothing is lit.
        """
        from mipbake.render import candidate

        uv, first, second = self._renders[index]
        problem = self._problem
        shaded = candidate(levels, problem.target, problem.wrap, uv, self._lods[index], self._pairs)
        sums = snr_sums(shaded, first, second).reshape(-1, self._each, 3)
        groups = max(1, self._each // SET_SIZE)
        sums = sums[:, : self._each // groups * groups].reshape(len(sums), groups, -1, 3).sum(2)
        sums = np.concatenate([sums, sums.sum(1, keepdims=True)], 1)
        return np.nan_to_num(-snr_from_sums(sums) * (math.log(10) / 10))


def typical(log_errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(S,) of what HeldOut.log_errors gives: halfway between the mean over sets and all pairs together."""
    return np.asarray((log_errors[..., :-1].mean(-1) + log_errors[..., -1]) / 2)


def random_points(
    problem: Problem, region: Region, lod: float, most: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """(P, 2) uv inside a region, at most so many; levels of few texels need few."""
    height, width = problem.sizes[int(lod)]
    texels = math.ceil(height * width * region.extent.prod())
    count = max(1, min(most, max(_PIXELS_A_TEXEL * texels, _LEAST_POINTS)))
    spread = (rng.random(2) + np.arange(count)[:, None] * _SEQUENCE) % 1
    return np.asarray(region.origin + spread * region.extent)


def draw_pairs(rng: np.random.Generator, each: int) -> LightViewPairs:
    """`each` random pairs drawn like every pair set in turn."""
    views = [cosine_directions(rng, each) for _ in PAIR_SETS]
    lights = [draw(rng, view) for draw, view in zip(PAIR_SETS.values(), views, strict=True)]
    return LightViewPairs(np.concatenate(lights).astype(np.float32), np.concatenate(views).astype(np.float32))


def samples_at(budget: Budget, lod: float) -> int:
    """Reference samples of a pixel in each of two estimates: pixels of coarse levels cover more texels."""
    return int(budget.samples // 2 * 2 ** min(round(lod), 4))


def estimate_twice(
    problem: Problem,
    uv: NDArray[np.float64],
    lod: float,
    pairs: LightViewPairs,
    budget: Budget,
    rng: np.random.Generator,
) -> tuple[Image, Image]:
    """Two independent estimates of the reference, (K, P, 3) each."""
    samples = samples_at(budget, lod)
    return estimate(problem, uv, lod, pairs, samples, rng), estimate(problem, uv, lod, pairs, samples, rng)


@lru_cache(maxsize=8)
def _quantiles(pixel_filter: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(table,) offsets in pixels at the midpoints of equally likely bins of |p|, and their weights."""
    offsets, weights = filter_named(pixel_filter).offsets((np.arange(_TABLE) + 0.5) / _TABLE)
    return offsets.astype(np.float32), weights.astype(np.float32)


def estimate(
    problem: Problem,
    uv: NDArray[np.float64],
    lod: float,
    pairs: LightViewPairs,
    samples: int,
    rng: np.random.Generator,
) -> Image:
    """(K, P, 3): what `mipbake.render.reference` estimates, where drawing takes longer than shading: few pairs a pixel.

    Offsets come from a table; the sequence of a pixel has a shift of its own, in integers, whose sums modulo the
    table's length are exact.
    """
    offsets, weights = _quantiles(problem.pixel_filter)
    signed = bool((weights < 0).any())
    height, width = problem.stored.shape[:2]
    pixel = 2.0**lod / np.array([width, height])
    sequence = (np.arange(samples)[:, None, None] * _SEQUENCE % 1 * _TABLE).astype(np.int64)
    out = np.empty((len(pairs.light), len(uv), 3), np.float32)
    chunk = max(1, _RADIANCES // len(pairs.light) // samples)

    def shaded(where: NDArray[np.float64]) -> Image:
        flat = where.reshape(1, 1, -1, 2)
        texels = sampling.texture(problem.stored[None], flat, filter_mode="linear", boundary_mode=problem.wrap)[0, 0]
        return shade(problem.source, texels, pairs.light, pairs.view)

    for start in range(0, len(uv), chunk):
        some = slice(start, start + chunk)
        centres = uv[some]
        quantile = (rng.integers(_TABLE, size=centres.shape) + sequence) & (_TABLE - 1)
        radiance = shaded(centres + offsets[quantile] * pixel).reshape(len(out), samples, len(centres), 3)
        if signed:
            weight = weights[quantile].prod(-1) / samples
            rest = (1 - weight.sum(0))[:, None]
            out[:, some] = (radiance * weight[..., None]).sum(1) + rest * shaded(centres)
        else:
            # A product with ones: several times faster than NumPy's sum along an axis in the middle.
            rows = radiance.reshape(len(out), samples, -1)
            out[:, some] = (np.full((1, samples), 1 / samples, np.float32) @ rows).reshape(len(out), -1, 3)
    return out
