"""How engines look a MIP stack up: where footprints are not round, samplers differ.

The longer and the shorter side of a footprint, in texels of level 0, are a >= b. A stack is looked up once for each
pixel, in its stored channels, and what comes out is shaded once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.aim import DEFAULT_SAMPLER, BakedSampler, sampler_among
from mipbake.errors import UsageError
from mipbake.pixel_filter import Wrap

Array = NDArray[np.float32]

Sampler = Literal[BakedSampler, "stochastic"]
"""`trilinear`: one lookup at the level of detail log2 a, between texels and between levels: what three.js does unless
it is told otherwise.
`anisotropic`: the mean of n = min(ceil(a / b), 16) trilinear lookups, evenly spaced along the longer side, at
log2(a / n) (EXT_texture_filter_anisotropic): what engines offer as 16x.
`stochastic`: one texel of one level, drawn with the weights that `trilinear` would give it (Pharr et al. 2024,
Filtering After Shading With Stochastic Texture Filtering, section 4): renderers that filter what is shaded average many
of these."""

SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)
"""Every sampler, the default first."""


def sampler_named(name: str) -> Sampler:
    """The sampler of that name; UsageError, with the list of names, where there is none."""
    return sampler_among(name, SAMPLERS, "sampler")


def baked_for(sampler: Sampler) -> BakedSampler:
    """The sampler that stacks are made for which one looks up so: `stochastic` draws what `trilinear` averages."""
    return "trilinear" if sampler == "stochastic" else sampler


def look_up(
    levels: Sequence[Array],
    uv: NDArray[np.float64],
    uv_da: NDArray[np.float64],
    wrap: Wrap,
    sampler: Sampler = DEFAULT_SAMPLER,
    rng: np.random.Generator | None = None,
) -> Array:
    """(P, C) float32 stored channels that a stack shows at P points.

    Args:
        levels: (H_L, W_L, C) float32 stored channels, finest first.
        uv: (P, 2) texture coordinates. uv_da: (P, 4) du/dX, du/dY, dv/dX, dv/dY per pixel.
        rng: draws the texels of `stochastic`, the only sampler that draws.

    Raises:
        UsageError: `stochastic` without `rng`.
    """
    if sampler == "stochastic":
        if rng is None:
            raise UsageError("the stochastic sampler has nothing to draw with: expected rng")
        return _one_texel(levels, uv, uv_da, wrap, rng)
    finest, *coarser = (np.asarray(level, np.float32)[None] for level in levels)
    found: Array = sampling.texture(
        finest,
        uv[None, None],
        uv_da[None, None],
        mip=coarser,
        filter_mode="anisotropic" if sampler == "anisotropic" else "linear-mipmap-linear",
        boundary_mode=wrap,
    )[0, 0]
    return found


def level_of_detail(uv_da: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """(P,): log2 of the longer axis, in texels of a level of `size` (height, width), of footprints (P, 4).

    The derivatives are du/dX, du/dY, dv/dX, dv/dY per pixel, as `sampling.texture` takes them.
    """
    ux, uy, vx, vy = (np.asarray(uv_da) * [size[1], size[1], size[0], size[0]]).T
    # The larger singular value of [[ux, uy], [vx, vy]].
    half, cross = (ux**2 + vx**2 + uy**2 + vy**2) / 2, ux * uy + vx * vy
    major2 = half + np.hypot((ux**2 + vx**2 - uy**2 - vy**2) / 2, cross)
    return np.asarray(0.5 * np.log2(np.maximum(major2, 1e-300)))


def _one_texel(
    levels: Sequence[Array],
    uv: NDArray[np.float64],
    uv_da: NDArray[np.float64],
    wrap: Wrap,
    rng: np.random.Generator,
) -> Array:
    """One texel each: a level drawn by the fraction of the level of detail, then the texel nearest to a point that is
    spread evenly over a texel's width, which draws each texel with its bilinear weight."""
    lod = level_of_detail(uv_da, levels[0].shape[:2]).clip(0, len(levels) - 1)
    index = np.floor(lod + rng.random(len(lod))).astype(np.intp).clip(0, len(levels) - 1)
    spread = rng.random((len(lod), 2)) - 0.5
    out = np.empty((len(lod), levels[0].shape[2]), np.float32)
    for number in np.unique(index):
        level = np.asarray(levels[number], np.float32)
        chosen = index == number
        at = uv[chosen] + spread[chosen] / [level.shape[1], level.shape[0]]
        out[chosen] = sampling.texture(level[None], at[None, None], filter_mode="nearest", boundary_mode=wrap)[0, 0]
    return out
