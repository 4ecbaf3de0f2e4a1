"""The stack of a mosaic of tiles, cut into a stack for each tile."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.base.errors import UsageError
from mipbake.material.pixel_filter import level_sizes
from mipbake.source.opacity import keeping_coverage
from mipbake.source.texture_set import TextureSet
from mipbake.source.udim import CLAMPED, Mosaic, exact_levels
from mipbake.stack.packing import source_files
from mipbake.stack.stack import MipStack


def stacks_of(read: Mosaic, baked: MipStack) -> Iterator[tuple[TextureSet, MipStack]]:
    """Every texture set of what was read and baked at once, with its own stack."""
    if 0 in read.sets:
        yield read.texture_set, baked
        return
    for tile, stack in split(baked, read).items():
        tiled = replace(read.sets[tile], wrap=stack.wrap)
        yield tiled, replace(stack, source_files=source_files(tiled), tile=tile)


def split(stack: MipStack, mosaic: Mosaic) -> Mapping[int, MipStack]:
    """The stack of every tile, cut out of the stack of the mosaic: tile number to a complete chain down to 1 x 1,
    clamped. UsageError where the stack is not the stack of the mosaic.

    Levels whose texels divide the tile evenly are cut out exactly: all of a square tile whose side is a power of two.
    The others are looked up in the mosaic's levels where their texels lie, trilinearly, as an engine would. Opacity
    that is tested against a cutoff keeps the coverage of each tile.
    """
    texture_set = mosaic.texture_set
    if stack.size != (texture_set.height, texture_set.width) or set(stack.extra) != set(texture_set.plain_maps):
        raise UsageError(
            f"the stack {stack.name} measures {stack.size[1]} x {stack.size[0]} and is not the stack of the mosaic of "
            f"{texture_set.width} x {texture_set.height}: bake the mosaic's texture set"
        )
    grid = (mosaic.rows, mosaic.columns)
    exact = exact_levels(stack.size[0] // mosaic.rows, stack.size[1] // mosaic.columns)
    promise = stack.provenance.promise
    if promise is not None:
        promise = promise.first(exact)
    stacks = {}
    for number, tile in mosaic.sets.items():
        cell, near = mosaic.cells[number], mosaic.near(number)
        # What is looked up between texels needs its vectors made unit again; what is cut out stays as it is.
        levels = [
            level if index < exact else material.regularise(level, stack.model)
            for index, level in enumerate(_cut(stack.levels, grid, cell))
        ]
        together = f"tile {number} was filtered across its borders with {', '.join(str(n) for n in near)}"
        own = hashlib.sha256(f"{stack.provenance.source_hash} {number}".encode()).hexdigest()
        provenance = replace(
            stack.provenance,
            sources=tile.found.hashes,
            source_hash=own,
            warnings=(*stack.provenance.warnings, *([f"{together}: bake them together again"] if near else [])),
            promise=promise,
        )
        extra = {role: _cut(stack.extra[role], grid, cell) for role in tile.plain_maps}
        if tile.alpha_cutoff is not None and "opacity" in extra:
            extra["opacity"] = keeping_coverage(extra["opacity"], tile.alpha_cutoff)
        stacks[number] = MipStack(tile.name, stack.model, levels, extra, CLAMPED, provenance)
    return stacks


def _cut(
    chain: Iterable[NDArray[np.float32]], grid: tuple[int, int], cell: tuple[int, int]
) -> list[NDArray[np.float32]]:
    """The chain of the tile at `cell` (row, column) out of the chain of the mosaic of `grid` (rows, columns) tiles."""
    levels = list(chain)
    height, width = (size // count for size, count in zip(levels[0].shape[:2], grid, strict=True))
    exact, sizes = exact_levels(height, width), level_sizes(height, width)
    out = []
    for index, (rows, columns) in enumerate(sizes):
        if index < exact:
            top, left = cell[0] * rows, cell[1] * columns
            part = levels[index][top : top + rows, left : left + columns]
        else:
            part = _trilinear(levels, grid, cell, (height, width), (rows, columns))
        out.append(np.ascontiguousarray(part))
    return out


def _trilinear(
    levels: list[NDArray[np.float32]],
    grid: tuple[int, int],
    cell: tuple[int, int],
    tile: tuple[int, int],
    size: tuple[int, int],
) -> NDArray[np.float32]:
    """A level of `size` (rows, columns) of a tile of that many texels, by trilinear lookups in the mosaic's levels.

    The level of detail follows the shorter side of a texel; along the longer one several lookups are averaged.
    """
    texel = [n / m for n, m in zip(tile, size, strict=True)]
    lod = min(float(np.log2(min(texel))), len(levels) - 1.0)
    taps = [max(1, round(t / 2**lod)) for t in texel]
    at = [
        (cell[axis] + (np.arange(size[axis] * taps[axis]) + 0.5) / (size[axis] * taps[axis])) / grid[axis]
        for axis in (0, 1)
    ]
    finer = int(lod)
    looked = _bilinear(levels[finer], at[0], at[1])
    if finer + 1 < len(levels):
        looked = looked + np.float32(lod - finer) * (_bilinear(levels[finer + 1], at[0], at[1]) - looked)
    averaged = looked.reshape(size[0], taps[0], size[1], taps[1], -1).mean((1, 3), dtype=np.float32)
    return np.asarray(averaged, np.float32)


def _bilinear(image: NDArray[np.float32], v: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float32]:
    """(H, W, C) at every combination of coordinates in [0, 1], clamped: (len(v), len(u), C)."""
    for axis, at in ((0, v), (1, u)):
        count = image.shape[axis]
        position = np.clip(at * count - 0.5, 0, count - 1)
        low = np.minimum(position.astype(np.intp), max(0, count - 2))
        high = np.minimum(low + 1, count - 1)
        share = (position - low).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        first = np.take(image, low, axis)
        image = first + share * (np.take(image, high, axis) - first)
    return image
