"""Normals that point along the surface or into it: holes in a normal map, filled from around them.

A tangent-space normal has a height z above 0. Exporters and compression leave a few that have not, or none at all, and
one of them is enough: its slope is without bound, so the mean slope of a pixel is its own, and rules that add up the
variance of slopes make the pixel as rough as can be, and dark. Such a texel says nothing but that
it is broken.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.material import MIN_NORMAL_Z
from mipbake.source.normal import normalised

Vectors = NDArray[np.float32]


_NO_LENGTH = 0.02
"""Length of a stored vector below which its direction is the rounding of 8 bits, or nothing."""


def holes(normals: Vectors, length: NDArray[np.float32] | None = None) -> NDArray[np.bool_]:
    """(H, W) which of (H, W, 3) unit vectors are not normals; `length` (H, W): their lengths before they were made
    unit."""
    found = memory.empty(normals.shape[:2], np.bool_)
    np.less(normals[..., 2], np.float32(MIN_NORMAL_Z), out=found)
    if length is not None:
        for row, of in zip(found, length, strict=True):
            np.logical_or(row, of < np.float32(_NO_LENGTH), out=row)
    return found


def held(normals: Vectors, length: NDArray[np.float32] | None = None) -> tuple[Vectors, int]:
    """Normals whose heights are MIN_NORMAL_Z or more, and how many texels had less.

    Those, and vectors without length, take the mean of their neighbours that have more, made unit; holes of several
    texels are filled from their rims inwards. Other texels stay bit for bit. Where no texel has more, all are flat.

    Args:
        normals: (H, W, 3) unit vectors.
        length: (H, W) of the vectors before they were made unit; None where they had none of their own.
    """
    broken = holes(normals, length)
    count = int(np.count_nonzero(broken))
    if not count:
        return normals, 0
    if count == broken.size:
        flat = np.zeros_like(normals)
        flat[..., 2] = 1
        return flat, count
    out, known = memory.copied(normals), ~broken
    rows, columns = np.nonzero(broken)
    while len(rows):
        total, found = np.zeros((len(rows), 3), np.float32), np.zeros(len(rows), np.bool_)
        for dy, dx in product((-1, 0, 1), repeat=2):
            y, x = rows + dy, columns + dx
            inside = (y >= 0) & (y < out.shape[0]) & (x >= 0) & (x < out.shape[1])
            y, x = np.where(inside, y, rows), np.where(inside, x, columns)
            seen = known[y, x]
            total += np.where(seen[:, None], out[y, x], 0)
            found |= seen
        out[rows[found], columns[found]] = normalised(total[found])
        known[rows[found], columns[found]] = True
        rows, columns = rows[~found], columns[~found]
    return out, count


def warning(label: str, count: int, texels: int) -> str:
    """What a user is told of broken normals."""
    they = "it takes" if count == 1 else "they take"
    return (
        f"{label}: {count} of {texels} normals along the surface, into it or without length (z below "
        f"{MIN_NORMAL_Z:g}): {they} the mean of those around; repair the map if that is too many"
    )
