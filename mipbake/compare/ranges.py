"""Ranges of the values in the textures of a GLB, chosen by what the shaded result loses."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from mipbake.compare.candidates import Candidate, opened
from mipbake.compare.compression import LODS, Progress, losses, part_of
from mipbake.io.gltf.ranges import Ranges, roughness_factor, scale_within, usual_ranges
from mipbake.io.gpu_files import GpuFile
from mipbake.io.layout import LAYOUTS, channels_of
from mipbake.io.map_files import Levels, MapFile, quantised_levels, stood_for
from mipbake.io.options import SHADING_ROLES
from mipbake.stack import MipStack
from mipbake.texture_set import TextureSet

_SHARES, _BEYOND = (0.5, 0.75, 0.9, 0.97), (2.0, 4.0)
"""Shares of slopes within the scales that are tried, and multiples of the largest of these scales."""

_APART = 1.1  # scales that are nearer to each other are one
_LEVELS = 1 + ceil(max(LODS))
_SIDE, _STEP = 512, 1 << (_LEVELS - 1)


def chosen_ranges(
    texture_set: TextureSet,
    stack: MipStack,
    progress: Progress = lambda _share: None,
    texels: str = "uastc",
) -> Ranges:
    """The ranges with which the normals of a stack cost the least.

    A small scale resolves small slopes finely and steep normals coarsely, and lets steep normals count less where
    texels are filtered; which effect shows depends on the material. So several scales are tried, on the middle of
    larger sets, and the one stays whose greater loss, near the mirror and over the hemisphere, is the smallest.

    Args:
        texture_set: that the stack was baked from, nothing in it hidden (`mipbake.opacity.shown`).
        stack: as it was baked, of `gltf` or `gltf-anisotropic`.
        progress: moved by every scale, then by every level of detail that is measured.
        texels: that the normals are to be stored in.
    """
    rough = roughness_factor(stack.levels, stack.model)
    if len(stack.levels) < _LEVELS:
        progress(1.0)
        return usual_ranges(stack.levels, stack.model)
    scales = _scales(stack)
    part, levels = _middle(texture_set, stack)
    variants: dict[str, Levels] = {}
    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        encoded = pool.map(lambda scale: _with_normals(levels, stack.model, Ranges(scale), texels), scales)
        for index, made in enumerate(encoded):
            variants[str(index)] = made
            progress((index + 1) / len(scales) / 2)
    baked = Candidate(opened(stack).method, levels)
    found = losses(part, baked, variants, part_of(progress, 1, 2))
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


def _with_normals(levels: Levels, model: str, ranges: Ranges, texels: str) -> Levels:
    """Levels whose normals are as the texture of a GLB would give them back."""
    layout = next(each.alone for each in LAYOUTS[model] if each.name == "normal")
    place = channels_of(model, "normal")
    container = GpuFile("ktx2", texels)
    stored = ranges.stored(MapFile(container, layout, [level[..., place] for level in levels]))
    found = container.decoded(layout, quantised_levels(stored))
    decoded = replace(stored, levels=[stood_for(each, container, layout) for each in found])
    made = []
    for level, normals in zip(levels, ranges.shown(decoded).levels, strict=True):
        made.append(level.copy())
        made[-1][..., place] = normals
    return made


def _middle(texture_set: TextureSet, stack: MipStack) -> tuple[TextureSet, Levels]:
    """The middle of a set, addressed with clamping where something is cut off, and the levels of its stack there."""
    height, width = stack.size
    if max(height, width) <= _SIDE or height % _STEP or width % _STEP:
        return texture_set, stack.levels[:_LEVELS]
    sides = [min(_SIDE, side) for side in (height, width)]
    top, left = ((whole - side) // 2 // _STEP * _STEP for whole, side in zip((height, width), sides, strict=True))

    def part(image: NDArray[np.float32], level: int) -> NDArray[np.float32]:
        rows, columns = (slice(at >> level, at + side >> level) for at, side in zip((top, left), sides, strict=True))
        return np.ascontiguousarray(image[rows, columns])

    maps = {r: replace(m, pixels=part(m.pixels, 0)) for r, m in texture_set.maps.items() if r in SHADING_ROLES}
    cut = (width > sides[1], height > sides[0])
    modes = [("clamp" if each else mode) for each, mode in zip(cut, texture_set.wrap, strict=True)]
    made = replace(texture_set, maps=maps, width=sides[1], height=sides[0], wrap=(modes[0], modes[1]))
    return made, [part(level, index) for index, level in enumerate(stack.levels[:_LEVELS])]
