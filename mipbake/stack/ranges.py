"""Ranges of the values in the textures of a GLB, chosen by what the shaded result loses."""

from __future__ import annotations

import os
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from mipbake.base.threads import on_threads
from mipbake.source.layout import LAYOUTS, channels_of
from mipbake.source.options import SHADING_ROLES
from mipbake.source.texture_set import TextureSet
from mipbake.stack.compression import LODS, Decoded, Progress, losses, part_of
from mipbake.stack.gltf.ranges import Ranges, roughness_factor, scale_within, usual_ranges
from mipbake.stack.gpu_files import KTX2, GpuFile
from mipbake.stack.map_files import Levels, MapFile
from mipbake.stack.output import GLB_TEXELS
from mipbake.stack.stack import MipStack
from mipbake.stack.written import opened

_SHARES, _BEYOND = (0.5, 0.75, 0.9, 0.97), (2.0, 4.0)
"""Shares of slopes within the scales that are tried, and multiples of the largest of these scales."""

_APART = 1.1  # scales that are nearer to each other are one
_LEVELS = 1 + ceil(max(LODS))  # levels that are measured: not tuned
_STEP = 1 << (_LEVELS - 1)  # texels of level 0 to a texel of the last of them: not tuned


def chosen_ranges(
    texture_set: TextureSet,
    stack: MipStack,
    progress: Progress = lambda _share: None,
    texels: str = GLB_TEXELS[0],
    side: int = 512,
) -> Ranges:
    """The ranges with which the normals of a stack cost the least.

    A small scale resolves small slopes finely and steep normals coarsely, and lets steep normals count less where
    texels are filtered; which effect shows depends on the material. So several scales are tried, on the middle of
    larger sets, and the one stays whose greater loss, near the mirror and over the hemisphere, is the smallest.

    Args:
        texture_set: that the stack was baked from, nothing in it hidden (`mipbake.source.opacity.shown`).
        stack: of `gltf` or `gltf-anisotropic`.
        texels: that the normals are to be stored in.
        side: texels of the middle's sides; a multiple of 8.
    """
    rough = roughness_factor(stack.levels, stack.model)
    if len(stack.levels) < _LEVELS:
        progress(1.0)
        return usual_ranges(stack.levels, stack.model)
    scales = _scales(stack)
    part, levels = _middle(texture_set, stack, side)
    stack = replace(stack, levels=levels)
    layout = next(each.alone for each in LAYOUTS[stack.model] if each.name == "normal")
    place, container = channels_of(stack.model, "normal"), GpuFile(KTX2, texels)
    normals = MapFile(container, layout, [level[..., place] for level in levels])
    encoded = on_threads(
        lambda index: Decoded(normals, container, stack, Ranges(scales[index])),
        len(scales),
        part_of(progress, 0, 2),
        os.cpu_count(),
    )
    variants = {str(index): made for index, made in enumerate(encoded)}
    found = losses(part, opened(stack), variants, part_of(progress, 1, 2))
    best = min(found, key=lambda name: max(found[name].values()))
    return Ranges(scales[int(best)], rough)


def _scales(stack: MipStack) -> list[float]:
    """The scales that are tried, from 1 down, none near another."""
    within = [scale_within(stack.levels, stack.model, share) for share in _SHARES]
    scales = [1.0]
    for scale in sorted([*within, *(round(factor * within[-1], 6) for factor in _BEYOND)], reverse=True):
        if scales[-1] > _APART * scale:
            scales.append(scale)
    return scales


def _middle(texture_set: TextureSet, stack: MipStack, side: int) -> tuple[TextureSet, Levels]:
    """The middle of a set, addressed with clamping where something is cut off, and the levels of its stack there."""
    height, width = stack.size
    if max(height, width) <= side or height % _STEP or width % _STEP:
        return texture_set, stack.levels[:_LEVELS]
    sides = [min(side, whole) for whole in (height, width)]
    top, left = ((whole - side) // 2 // _STEP * _STEP for whole, side in zip((height, width), sides, strict=True))

    def part(image: NDArray[np.float32], level: int) -> NDArray[np.float32]:
        rows, columns = (
            slice(at >> level, at + length >> level) for at, length in zip((top, left), sides, strict=True)
        )
        return np.ascontiguousarray(image[rows, columns])

    maps = {r: replace(m, pixels=part(m.pixels, 0)) for r, m in texture_set.maps.items() if r in SHADING_ROLES}
    cut = (width > sides[1], height > sides[0])
    modes = [("clamp" if each else mode) for each, mode in zip(cut, texture_set.wrap, strict=True)]
    made = replace(texture_set, maps=maps, width=sides[1], height=sides[0], wrap=(modes[0], modes[1]))
    return made, [part(level, index) for index, level in enumerate(stack.levels[:_LEVELS])]
