"""How engines look a MIP stack up: where footprints are not round, samplers differ (`mipbake.material.aim.Sampler`).

A stack is looked up once for each pixel, or for each pixel of each frame, in its stored channels, and what comes out is
shaded once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.base.errors import UsageError
from mipbake.material.aim import DEFAULT_SAMPLER, LOOKUPS, SAMPLERS, TRILINEAR, Sampler, sampler_of
from mipbake.material.pixel_filter import Wrap

Array = NDArray[np.float32]

STOCHASTIC: Literal["stochastic"] = "stochastic"
"""One texel of one level, drawn with the weights that trilinear filtering would give it (Pharr et al. 2024, Filtering
After Shading With Stochastic Texture Filtering, section 4): renderers that filter what is shaded average many."""

RenderSampler = Sampler | Literal["stochastic"]
"""How a render looks a stack up: as an engine does, or as a renderer does that filters what is shaded."""

RENDER_SAMPLERS = (*SAMPLERS, STOCHASTIC)
"""What the samplers of renders are called, the default first."""


def render_sampler(name: str, lod_bias: float | None = None) -> RenderSampler:
    """The sampler of that name (`mipbake.material.aim.sampler_named`), with another MIP bias where one is given.

    Raises:
        UsageError: there is none, or the stochastic one with a bias.
    """
    if name != STOCHASTIC:
        return sampler_of(name, lod_bias) or DEFAULT_SAMPLER
    if lod_bias:
        raise UsageError(f"the sampler {STOCHASTIC} takes no MIP bias: leave it out, or choose another sampler")
    return STOCHASTIC


def baked_for(sampler: RenderSampler) -> Sampler:
    """The sampler that stacks are made for which one looks up so: `stochastic` draws what trilinear averages."""
    return TRILINEAR if sampler == STOCHASTIC else sampler


@cache
def jitter(frames: int) -> NDArray[np.float64]:
    """(frames, 2) offsets from the pixel's centre to the points that frames show, in pixels: Halton points of the bases
    2 and 3, as engines have them; the centre itself for a single frame."""
    if frames == 1:
        return np.zeros((1, 2))
    return np.stack([[_radical_inverse(index, base) for base in (2, 3)] for index in range(1, frames + 1)]) - 0.5


def _radical_inverse(index: int, base: int) -> float:
    inverse, scale = 0.0, 1.0
    while index:
        scale /= base
        index, digit = divmod(index, base)
        inverse += digit * scale
    return inverse


def over_frames(sampler: RenderSampler, render: Callable[[tuple[float, float]], Array]) -> Array:
    """The mean of what a render gives for each frame of a sampler, by the offset of the point that the frame shows."""
    frames = [render((float(x), float(y))) for x, y in jitter(baked_for(sampler).frames)]
    return frames[0] if len(frames) == 1 else np.asarray(np.mean(frames, 0, dtype=np.float64), np.float32)


def frames_at(uv: NDArray[np.float64], axes: NDArray[np.floating], frames: int) -> NDArray[np.float64]:
    """(..., P frames, 2) points that frames show of (..., P, 2) pixels, the frames of a pixel side by side.

    Args:
        axes: of pixels in units of the texture, an array that broadcasts to (..., P, 2, 2).
    """
    if frames == 1:
        return np.asarray(uv)
    at = uv[..., None, :] + jitter(frames) @ np.asarray(axes, np.float64)
    return np.asarray(at.reshape(*uv.shape[:-2], -1, 2))


def mean_of_frames(radiance: Array, frames: int) -> Array:
    """(..., P, 3) means over frames of (..., P frames, 3), the frames of a pixel side by side."""
    if frames == 1:
        return radiance
    # As a product of matrices: far faster than NumPy's mean, whose inner loops run over three colours.
    rows = radiance.reshape(-1, frames * 3) @ _shares(frames)
    return np.asarray(rows.reshape(*radiance.shape[:-2], -1, 3))


def in_frames(gradient: Array, frames: int) -> Array:
    """(..., P frames, 3) derivatives by every frame, from (..., P, 3) derivatives by `mean_of_frames`."""
    if frames == 1:
        return gradient
    rows = np.asarray(gradient, np.float32).reshape(-1, 3) @ _shares(frames).T
    return np.asarray(rows.reshape(*gradient.shape[:-2], -1, 3))


@cache
def _shares(frames: int) -> Array:
    """(frames 3, 3) of the colours of every frame in the colours of a pixel."""
    return np.asarray(np.tile(np.eye(3), (frames, 1)) / frames, np.float32)


def look_up(
    levels: Sequence[Array],
    uv: NDArray[np.float64],
    uv_da: NDArray[np.float64],
    wrap: Wrap,
    sampler: RenderSampler = DEFAULT_SAMPLER,
    rng: np.random.Generator | None = None,
) -> Array:
    """(P, C) float32 stored channels that one frame of a stack shows at P points.

    Args:
        levels: (H_L, W_L, C) float32 stored channels, finest first.
        uv: (P, 2) texture coordinates. uv_da: (P, 4) du/dX, du/dY, dv/dX, dv/dY per pixel.
        rng: draws the texels of `stochastic`, the only sampler that draws.
    """
    if sampler == STOCHASTIC:
        assert rng is not None
        return _one_texel(levels, uv, uv_da, wrap, rng)
    finest, *coarser = (np.asarray(level, np.float32)[None] for level in levels)
    if 1 < sampler.lookups < LOOKUPS[-1]:
        uv_da = _held(uv_da, finest.shape[1:3], sampler.lookups)
    found: Array = sampling.texture(
        finest,
        uv[None, None],
        uv_da[None, None],
        mip_level_bias=[[[sampler.bias]]] if sampler.bias else None,
        mip=coarser,
        filter_mode="anisotropic" if sampler.lookups > 1 else "linear-mipmap-linear",
        boundary_mode=wrap,
    )[0, 0]
    return found


def _held(uv_da: NDArray[np.float64], size: tuple[int, ...], lookups: int) -> NDArray[np.float64]:
    """(P, 4) footprints that are no longer than so many times their width: those that were are widened.

    The door makes up to 16 lookups, as many as a footprint is longer than wide. A footprint that is as wide as its
    longer side over the most lookups has this many of them, at the same places and level of detail.
    """
    scale = np.array([size[1], size[0]], np.float64)[:, None]
    matrices = np.asarray(uv_da, np.float64).reshape(-1, 2, 2) * scale
    left, sides, right = np.linalg.svd(matrices)
    long = np.flatnonzero(sides[:, 0] > lookups * sides[:, 1])
    sides[long, 1] = sides[long, 0] / lookups
    out = np.array(uv_da, np.float64)
    out[long] = ((left[long] * sides[long, None]) @ right[long] / scale).reshape(-1, 4)
    return out


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
