"""Blocks of normal maps that lose the least of what is shaded.

Renderers renormalise what they sample, so a normal may be stored at any length, and an encoder makes other blocks of
every length. Blocks do not depend on each other: each is taken from the encoding whose directions it keeps best.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake.io.blocks import from_blocks
from mipbake.io.gpu_files import GpuFile
from mipbake.io.gpu_format import GpuTexture
from mipbake.io.layout import FileLayout
from mipbake.io.map_files import Levels, MapFile, quantised_levels, row_blocks, stood_for

_LEAST_ROUGHNESS = 0.045
"""Perceptual; renderers raise less to it."""

_LEAST_Z = 0.02  # decoded normals below it are as wrong as can be

_LENGTHS = (1.0, 0.0, 0.95, -0.93, -0.86)
"""Of stored normals, in the order of their use: positive ones are lengths, for 0 or less the largest component has
their magnitude, 0 standing for 1: then z is the same in all texels that are not steep, and costs no bits."""

EFFORTS = range(1, 1 + len(_LENGTHS))
"""How many encodings there can be."""


def best_blocks(file: MapFile, weights: Levels, effort: int, about: str) -> GpuTexture:
    """The texture of a normal map.

    Args:
        file: of three channels and unit normals, for a container of blocks.
        weights: (H_L, W_L) of every level: what a squared error of the slopes costs at each texel.
        effort: how many encodings there are, in `EFFORTS`.
        about: how the map was made, as JSON.
    """
    container = file.container
    assert isinstance(container, GpuFile)
    best: GpuTexture | None = None
    lost: list[NDArray[np.float64]] = []
    kept: list[bytes] = []
    for length in _LENGTHS[:effort]:
        given = MapFile(container, file.layout, [_of_length(level, length) for level in file.levels])
        made = container.texture(file.layout, quantised_levels(given), about)
        if effort == 1:
            return made
        pairs = zip(from_blocks(made), file.levels, weights, strict=True)
        errors = [_errors(texels, level, weight, container, file.layout) for texels, level, weight in pairs]
        if best is None:
            best, lost, kept = made, errors, list(made.levels)
            continue
        for index, (error, data) in enumerate(zip(errors, made.levels, strict=True)):
            better = error < lost[index]
            lost[index] = np.where(better, error, lost[index])
            kept[index] = _mixed(kept[index], data, better, made.format.block)
    assert best is not None
    return GpuTexture(best.format, best.width, best.height, tuple(kept), best.values)


def lobe_weights(roughness: Sequence[NDArray[np.float32]], normals: Sequence[NDArray[np.float32]]) -> Levels:
    """What a squared error of the slopes costs the shaded result, of (H_L, W_L) roughness and (H_L, W_L, 3) normals.

    A lobe of GGX has the height 1 / alpha^2 and the width alpha, so that its squared change under a small turn, summed
    over directions, goes with 1 / alpha^4; a change of a steep slope turns the normal by less, by z^2.
    """
    return [
        np.asarray(np.maximum(r, _LEAST_ROUGHNESS) ** -8.0 * np.maximum(n[..., 2], 0) ** 4, np.float32)
        for r, n in zip(roughness, normals, strict=True)
    ]


def _of_length(level: NDArray[np.float32], length: float) -> NDArray[np.float32]:
    if length > 0:
        return np.asarray(level * length, np.float32)
    most = np.abs(level).max(-1, keepdims=True)
    return np.asarray(level * ((-length or 1.0) / np.maximum(most, np.finfo(np.float32).tiny)), np.float32)


def _errors(
    texels: NDArray[np.generic],
    level: NDArray[np.float32],
    weight: NDArray[np.float32],
    container: GpuFile,
    layout: FileLayout,
) -> NDArray[np.float64]:
    """Weighted squared errors of the slopes, summed over every block."""
    error = np.empty(level.shape[:2], np.float32)
    for block, found, wanted, w in zip(*(row_blocks(a) for a in (error, texels, level, weight)), strict=True):
        shown = stood_for(found[..., :3], container, layout)
        block[:] = w * np.square(_slopes(shown) - _slopes(wanted)).sum(-1)
    rows, columns = error.shape
    padded = np.pad(error, ((0, -rows % 4), (0, -columns % 4)))
    return np.asarray(padded.reshape(-(-rows // 4), 4, -1, 4).sum((1, 3), dtype=np.float64).reshape(-1))


def _slopes(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(normals[..., :2] / np.maximum(normals[..., 2:], _LEAST_Z), np.float32)


def _mixed(first: bytes, second: bytes, second_better: NDArray[np.bool_], size: int) -> bytes:
    blocks = [np.frombuffer(data, np.uint8).reshape(-1, size) for data in (first, second)]
    return np.where(second_better[:, None], blocks[1], blocks[0]).tobytes()
