"""Renders in texture space: every pixel looks straight at the surface and covers 2^lod texels of level 0.

Lighting and viewing directions are constant over a pixel (section 3.2 of Kemppinen et al. 2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling, shading
from mipbake.material.pixel_filter import Wrap
from mipbake.quality.metrics.pairs import LightViewPairs


@runtime_checkable
class LooksUp(Protocol):
    """Levels that are looked up in their own way, because they do not lie in memory as they are meant."""

    def lookup(self, uv: NDArray[np.float64], lod: float, wrap: Wrap) -> NDArray[np.float32]:
        """(P, C) float32, as `lookup` gives it."""


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
    return shading.shade(model, lookup(levels, uv, lod, wrap), pairs.light, pairs.view)


def lookup(levels: Sequence[NDArray[Any]], uv: NDArray[np.float64], lod: float, wrap: Wrap) -> NDArray[np.float32]:
    """(P, C) float32: one trilinear lookup of levels (H_L, W_L, C) of float32 or float16 at each of (P, 2) uv; by the
    levels themselves where they look up in their own way."""
    if isinstance(levels, LooksUp):
        return levels.lookup(uv, lod, wrap)
    finest, *coarser = (level[None] for level in levels)
    texels = sampling.texture(
        finest,
        uv[None, None],
        mip_level_bias=[[[lod]]],
        mip=coarser,
        filter_mode="linear-mipmap-linear",
        boundary_mode=wrap,
    )
    return np.asarray(texels[0, 0], np.float32)
