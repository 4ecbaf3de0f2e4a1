"""Estimates of the filtered render of level 0 (equation 3 of Kemppinen et al. 2023)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.metrics.pairs import LightViewPairs
from mipbake.reference.problem import Image, Problem
from mipbake.reference.sequences import QUANTILES, SEQUENCE, quantiles
from mipbake.shading import shade

_RADIANCES = 1 << 17  # at a time: they stay in the cache


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
