"""Renders in texture space: every pixel looks straight at the surface and covers 2^lod texels of level 0.

Lighting and viewing directions are constant over a pixel (section 3.2 of Kemppinen et al. 2023).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling, shading
from mipbake.metrics.pairs import LightViewPairs
from mipbake.pixel_filter import Wrap, filter_named
from mipbake.reference.sequences import SEQUENCE

_CHUNK = 1024  # pixels shaded at a time: the radiance of 128 pairs, 1.5 MiB, stays in the cache


def reference(
    stored: NDArray[np.float32],
    model: str,
    wrap: Wrap,
    uv: NDArray[np.float64],
    lod: float,
    pixel_filter: str,
    pairs: LightViewPairs,
    samples: int,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Unbiased Monte Carlo estimate of equation 3: the integral of p((x', y') / 2^lod) f(theta(x - x', y - y'), l, v).

    Args:
        stored: (H, W, C) stored channels of level 0, interpolated bilinearly before anything else happens to them.
        uv: (P, 2) pixel centres; lod the same for all.
        pairs: K light-view pairs.
        samples: surface samples per pixel, importance-sampled from p: a quasirandom sequence under a random shift
            of its own for each pixel, so that estimates from different generators are independent.

    Returns:
        (K, P, 3) float32 linear radiance.
    """
    kernel = filter_named(pixel_filter)
    height, width = stored.shape[:2]
    pixel = 2.0**lod / np.array([width, height])
    sequence = np.arange(samples)[:, None, None] * SEQUENCE
    at_once = max(1, _CHUNK // len(uv))
    total = np.zeros((len(pairs.light), len(uv), 3), np.float32)
    for start in range(0, len(uv), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        offset, sign = kernel.offsets((rng.random((len(uv[chunk]), 2)) + sequence) % 1.0)
        weight = sign.prod(-1).astype(np.float32)
        part = np.zeros_like(total[:, chunk])
        for first in range(0, samples, at_once):
            some = slice(first, first + at_once)
            where = (uv[chunk] + offset[some] * pixel).reshape(-1, 2)
            texels = _lookup(stored, where, wrap)
            radiance = shading.shade(model, texels, pairs.light, pairs.view)
            radiance = radiance.reshape(len(part), -1, *part.shape[1:])
            if kernel.signed:  # else every weight is 1: passes over the radiance cost as much as the shading
                radiance *= weight[some, :, None]
            part += radiance[:, 0] if radiance.shape[1] == 1 else radiance.sum(1)
        if kernel.signed:
            # Weights of both signs sum to 1 on average only. The pixel's centre as a control variate takes up the rest:
            # still unbiased, and without error on a constant material.
            texels = _lookup(stored, uv[chunk], wrap)
            rest = (samples - weight.sum(0))[:, None]
            part += rest * shading.shade(model, texels, pairs.light, pairs.view)
        total[:, chunk] = part / samples
    return total


def candidate(
    levels: Sequence[NDArray[np.float32]],
    model: str,
    wrap: Wrap,
    uv: NDArray[np.float64],
    lod: float,
    pairs: LightViewPairs,
) -> NDArray[np.float32]:
    """What an unchanged engine shows: one trilinear lookup of the stack at each of (P, 2) uv, shaded once.

    Returns (K, P, 3) float32 linear radiance.
    """
    finest, *coarser = (level[None] for level in levels)
    texels = sampling.texture(
        finest,
        uv[None, None],
        mip_level_bias=[[[lod]]],
        mip=coarser,
        filter_mode="linear-mipmap-linear",
        boundary_mode=wrap,
    )
    return shading.shade(model, texels[0, 0], pairs.light, pairs.view)


def _lookup(level: NDArray[np.float32], uv: NDArray[np.float64], wrap: Wrap) -> NDArray[np.float32]:
    """(P, C): one level at (P, 2), bilinearly."""
    texels: NDArray[np.float32] = sampling.texture(
        level[None], uv[None, None], filter_mode="linear", boundary_mode=wrap
    )[0, 0]
    return texels
