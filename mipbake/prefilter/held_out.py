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

LOBES = 2  # lobes that half vectors of pixels are drawn from (pixel_samples.py)

SEQUENCE = np.array([0.7548776662466927, 0.5698402909980532])
"""Additive recurrence of low discrepancy (Roberts 2018): powers of 1 / plastic number."""

QUANTILES = 1 << 14  # quantiles of the pixel filter in a table

_PIXELS_A_TEXEL, _LEAST_POINTS = 4, 128
_HELD_OUT_STREAM = 104729  # keeps these pairs apart from every set that pair_set draws
_RADIANCES = 1 << 17  # at a time: they stay in the cache


@dataclass(frozen=True)
class Budget:
    """How much effort an optimisation makes, and how long it may take; whichever ends first.

    Args:
        rounds: most rounds of a block. A round draws pixels, pairs and targets anew; after every few of them held-out
            pairs say whether that still helps.
        steps: Gauss-Newton steps of a round.
        pairs: light-view pairs of each pixel in a round, a multiple of 2 + LOBES: each has its own.
        samples: reference samples of a pixel of level 0; they double with every second level.
        points: held-out pixels for each level of detail. held_out_pairs: held-out pairs of each set.
        window: blocks of large sets are at most so many texels a side.
        lit: whether renders under a studio's lights, tonemapped, count beside the renders of pairs (lit_samples.py).
        seconds: wall-clock limit, checked after each round; None for none. Only without one are results reproducible.
    """

    rounds: int = 40
    steps: int = 2
    pairs: int = 32
    samples: int = 8
    points: int = 256
    held_out_pairs: int = 1024
    window: int = 512
    lit: bool = False
    seconds: float | None = None

    def __post_init__(self) -> None:
        least = {"rounds": 0, "steps": 1, "pairs": 4, "samples": 2, "points": 1, "held_out_pairs": 2, "window": 8}
        for name, low in least.items():
            value = getattr(self, name)
            if not isinstance(value, int) or value < low:
                raise UsageError(f"{name} of the budget is {value!r}: expected a whole number from {low} up")
        for name, factor in (("pairs", len(PAIR_SETS) + LOBES), ("samples", 2)):
            if getattr(self, name) % factor:
                raise UsageError(f"{name} of the budget is {getattr(self, name)}: expected a multiple of {factor}")
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

    @property
    def last(self) -> int:
        """Index of the coarsest level."""
        return len(self.sizes) - 1


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


def whole(problem: Problem) -> Region:
    """All of the texture and all of its levels."""
    return Region(0, 1, 0, 1, range(problem.last + 1))


class HeldOut:
    """Reference renders of held-out pairs at fixed pixels, to measure any stack by.

    The SNR of a set of pairs hangs on its few brightest, so it varies by decibels from one set of 64 to the next. So
    several sets are measured.

    Args:
        region: where the pixels lie, and for which levels: levels of detail run from the first to the last of them in
            steps of 1/2, and half a level further where there is one more.
        stream: of random numbers.
        part: divides the points and pairs of the effort.
    """

    def __init__(self, problem: Problem, region: Region, budget: Budget, stream: list[int], part: int = 1) -> None:
        self._problem, self.each = problem, max(2, budget.held_out_pairs // part)
        self.lods = [level + half for level in region.levels for half in (0.0, 0.5) if level + half <= problem.last]
        rng = np.random.default_rng([_HELD_OUT_STREAM, *stream])
        self.pairs = draw_pairs(rng, self.each)
        self._renders = [
            (uv, *estimates)
            for lod in self.lods
            for uv in [random_points(problem, region, lod, max(1, budget.points // part), rng)]
            for estimates in [estimate_twice(problem, uv, lod, self.pairs, budget, rng)]
        ]
        self._fixed = [snr_sums(first, first, second) / len(uv) for uv, first, second in self._renders]

    def sums(self, levels: Sequence[Image], index: int) -> NDArray[np.float64]:
        """(S, K, 3) signal, error and noise of every pair of S pair sets, means over pixels (metrics.snr.snr_sums)."""
        from mipbake.render import candidate

        uv, first, second = self._renders[index]
        problem = self._problem
        shaded = candidate(levels, problem.target, problem.wrap, uv, self.lods[index], self.pairs)
        out = self._fixed[index].copy()
        # In float32: a sum over pixels and colours rounds by far less than it varies.
        out[:, 1] = np.einsum("kpc,kpc->k", shaded - first, shaded - second) / len(uv)
        return np.asarray(out.reshape(-1, self.each, 3))

    def log_errors(self, levels: Sequence[Image], index: int) -> NDArray[np.float64]:
        """(S, G) natural logarithm of the error relative to the signal, of G sets of pairs like each of S pair sets.

        0 where nothing is lit.
        """
        sums = self.sums(levels, index)
        groups = max(1, self.each // SET_SIZE)
        sums = sums[:, : self.each // groups * groups].reshape(len(sums), groups, -1, 3).sum(2)
        return np.nan_to_num(-snr_from_sums(sums) * (math.log(10) / 10))

    def typical(self, levels: Sequence[Image]) -> NDArray[np.float64]:
        """(S, M) means over sets of pairs of `log_errors` at every level of detail."""
        return np.stack([self.log_errors(levels, index).mean(-1) for index in range(len(self.lods))], 1)


def random_points(
    problem: Problem, region: Region, lod: float, most: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """(P, 2) uv inside a region, at most so many; levels of few texels need few."""
    height, width = problem.sizes[int(lod)]
    texels = math.ceil(height * width * region.extent.prod())
    count = max(1, min(most, max(_PIXELS_A_TEXEL * texels, _LEAST_POINTS)))
    spread = (rng.random(2) + np.arange(count)[:, None] * SEQUENCE) % 1
    return np.asarray(region.origin + spread * region.extent)


def draw_pairs(rng: np.random.Generator, each: int) -> LightViewPairs:
    """`each` random pairs drawn like every pair set in turn."""
    views = [cosine_directions(rng, each) for _ in PAIR_SETS]
    lights = [draw(rng, view) for draw, view in zip(PAIR_SETS.values(), views, strict=True)]
    return LightViewPairs(np.concatenate(lights).astype(np.float32), np.concatenate(views).astype(np.float32))


def estimate_twice(
    problem: Problem,
    uv: NDArray[np.float64],
    lod: float,
    pairs: LightViewPairs,
    budget: Budget,
    rng: np.random.Generator,
) -> tuple[Image, Image]:
    """Two independent estimates of the reference, (K, P, 3) each: pixels of coarse levels cover more texels."""
    samples = int(budget.samples * 2 ** min(round(lod), 3))
    return estimate(problem, uv, lod, pairs, samples, rng), estimate(problem, uv, lod, pairs, samples, rng)


@lru_cache(maxsize=8)
def quantiles(pixel_filter: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(QUANTILES,) offsets in pixels at the midpoints of equally likely bins of |p|, and their weights."""
    offsets, weights = filter_named(pixel_filter).offsets((np.arange(QUANTILES) + 0.5) / QUANTILES)
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
    offsets, weights = quantiles(problem.pixel_filter)
    signed = bool((weights < 0).any())
    height, width = problem.stored.shape[:2]
    pixel = 2.0**lod / np.array([width, height])
    sequence = (np.arange(samples)[:, None, None] * SEQUENCE % 1 * QUANTILES).astype(np.int64)
    out = np.empty((len(pairs.light), len(uv), 3), np.float32)
    chunk = max(1, _RADIANCES // len(pairs.light) // samples)

    def shaded(where: NDArray[np.float64]) -> Image:
        flat = where.reshape(1, 1, -1, 2)
        texels = sampling.texture(problem.stored[None], flat, filter_mode="linear", boundary_mode=problem.wrap)[0, 0]
        return shade(problem.source, texels, pairs.light, pairs.view)

    for start in range(0, len(uv), chunk):
        some = slice(start, start + chunk)
        centres = uv[some]
        quantile = (rng.integers(QUANTILES, size=centres.shape) + sequence) & (QUANTILES - 1)
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


def look_up(level: Image, uv: NDArray[np.float64], problem: Problem) -> Image:
    """(..., C): an image at (..., 2) uv, bilinearly."""
    return np.asarray(
        sampling.texture(level[None], uv[None, None], filter_mode="linear", boundary_mode=problem.wrap)[0, 0]
    )


def sample_offsets(
    problem: Problem, shape: tuple[int, ...], lod: float | NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """(S, ..., 2) offsets of samples from their pixel's centre, and (S, ...) weights whose sum over S is about 1.

    lod: level of detail of all pixels, or (..., 1) of each.
    """
    offsets, weights = quantiles(problem.pixel_filter)
    height, width = problem.stored.shape[:2]
    sequence = np.arange(shape[0]).reshape(-1, *(1,) * len(shape)) * SEQUENCE % 1 * QUANTILES
    place = (rng.integers(QUANTILES, size=(*shape[1:], 2)) + sequence.astype(np.int64)) & (QUANTILES - 1)
    return offsets[place] * (2.0**lod / np.array([width, height])), weights[place].prod(-1) / np.float32(shape[0])
