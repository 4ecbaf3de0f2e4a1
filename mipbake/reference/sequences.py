"""Where pixels lie, and offsets of the reference's samples from them."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mipbake.pixel_filter import filter_named
from mipbake.reference.problem import Problem, Region

SEQUENCE = np.array([0.7548776662466927, 0.5698402909980532])
"""Additive recurrence of low discrepancy (Roberts 2018): powers of 1 / plastic number."""

QUANTILES = 1 << 14
"""Quantiles of the pixel filter in a table."""

_PIXELS_A_TEXEL, _LEAST_POINTS = 4, 128


def random_points(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count, 2) texture coordinates: a low-discrepancy sequence with a random shift, at random sub-texel offsets."""
    return np.asarray((rng.random(2) + np.arange(count)[:, None] * SEQUENCE) % 1.0)


def region_points(
    problem: Problem, region: Region, lod: float, most: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """(P, 2) uv inside a region, at most so many; levels of few texels need few."""
    height, width = problem.sizes[int(lod)]
    texels = math.ceil(height * width * region.extent.prod())
    count = max(1, min(most, max(_PIXELS_A_TEXEL * texels, _LEAST_POINTS)))
    return np.asarray(region.origin + random_points(rng, count) * region.extent)


@lru_cache(maxsize=8)
def quantiles(pixel_filter: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(QUANTILES,) offsets in pixels at the midpoints of equally likely bins of |p|, and their weights."""
    offsets, weights = filter_named(pixel_filter).offsets((np.arange(QUANTILES) + 0.5) / QUANTILES)
    return offsets.astype(np.float32), weights.astype(np.float32)


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
