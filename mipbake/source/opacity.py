"""Opacity: colours that a mask hides do not bleed, and what is tested against a threshold keeps its coverage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mipbake.material.directions import untangled
from mipbake.material.fill import fill
from mipbake.material.pixel_filter import filtered_levels, resample
from mipbake.source.decode import unit_vectors, upsample
from mipbake.source.options import SHADING_ROLES
from mipbake.source.texture_set import TextureSet

Image = NDArray[np.float32]
Wrap = tuple[str, str]


def opacity_of(texture_set: TextureSet) -> Image | None:
    """(H, W) opacity of a set at the size of its maps that shade; None where it hides nothing."""
    if "opacity" not in texture_set.maps or texture_set.maps["opacity"].pixels.min() >= 1:
        return None
    opacity, wrap = texture_set.maps["opacity"].pixels, texture_set.wrap
    size = (texture_set.height, texture_set.width)
    # Interpolated where it is smaller along a side, averaged where it is larger.
    height, width = (max(a, b) for a, b in zip(size, opacity.shape[:2], strict=True))
    resized = np.ascontiguousarray(upsample(opacity, width, height, wrap))
    return resample(resized, size, "box", wrap)[..., 0] if (height, width) != size else resized[..., 0]


def shown(texture_set: TextureSet) -> TextureSet:
    """A texture set whose maps that shade have what is wholly transparent filled from its surroundings."""
    opacity = opacity_of(texture_set)
    if opacity is None:
        return texture_set
    weights = (opacity > 0).astype(np.float32)
    maps = dict(texture_set.maps)
    for role, each in texture_set.maps.items():
        if role not in SHADING_ROLES:
            continue
        pixels = untangled(each.pixels, texture_set.wrap) if role == "anisotropy" else each.pixels
        maps[role] = replace(each, pixels=unit_vectors(fill(pixels, weights, texture_set.wrap), role))
    return replace(texture_set, maps=maps)


def covering(
    levels: Sequence[Image], stored: Image, opacity: Image, colours: slice, pixel_filter: str, wrap: Wrap
) -> list[Image]:
    """Baked levels (H_L, W_L, C) whose base colours count by their opacity; see `premultiplied`. `stored`: (H, W, C) of
    level 0 of the source, nothing in it hidden, base colours in the same channels."""
    made = premultiplied(stored[..., colours], opacity, [level[..., colours] for level in levels], pixel_filter, wrap)
    out = [level.copy() for level in levels]
    for level, colour in zip(out, made, strict=True):
        level[..., colours] = colour
    return out


def premultiplied(colour: Image, opacity: Image, levels: Sequence[Image], pixel_filter: str, wrap: Wrap) -> list[Image]:
    """Baked base colours (H_L, W_L, 3) as if they had been filtered by opacity (H, W): texels count for as much as they
    cover. Every level is multiplied by the ratio of the average that is weighted by opacity to the plain one, which
    leaves what a method made of colours beyond averaging, and stays in [0, 1]; where nothing is covered, it is as it
    was.

    Args:
        colour: (H, W, 3) linear base colour of the source, nothing in it hidden.
        pixel_filter: that the levels were baked for.
    """
    weight = opacity[..., None]
    chains = [filtered_levels(image, pixel_filter, wrap) for image in (colour * weight, weight, colour)]
    out = []
    for level, product, cover, plain in zip(levels, *chains, strict=True):
        covered = cover > 1e-4
        average = np.where(covered, product / np.maximum(cover, 1e-4), plain)
        ratio = np.where(plain > 1e-6, average / np.maximum(plain, 1e-6), 1)
        out.append(np.clip(level * ratio, 0, 1).astype(np.float32))
    return out


def coverage(level: Image, cutoff: float) -> float:
    """The share of a level's texels that pass the test."""
    return float(np.mean(level >= np.float32(cutoff)))


def keeping_coverage(levels: Sequence[Image], cutoff: float) -> list[Image]:
    """Levels (H_L, W_L, 1) of an opacity that is tested against a cutoff, scaled so that as much passes as at level 0.

    Averaging lets thin leaves and wires vanish, or fences close, in the distance. Every level is multiplied by the
    factor that brings the share of texels above the cutoff the nearest to the share in level 0 (as the texture tools of
    Castano 2010, "Computing alpha mipmaps", do by search). Level 0 is never altered.
    """
    share = coverage(levels[0], cutoff)
    out = [levels[0]]
    for level in levels[1:]:
        scale = np.float32(cutoff / max(_threshold(level, share), 1e-6))
        out.append(np.clip(level * scale, 0, 1).astype(np.float32))
    return out


def _threshold(level: Image, share: float) -> float:
    """What the nearest to that share of texels lies above: between two values that occur, or beyond all."""
    values, counts = np.unique(level, return_counts=True)
    above = np.append(np.cumsum(counts[::-1])[::-1], 0) / level.size  # share that passes a threshold below values[i]
    between = np.concatenate([values[:1] / 2, (values[:-1] + values[1:]) / 2, values[-1:] + 1e-3])
    return float(between[int(np.argmin(np.abs(above - share)))])
