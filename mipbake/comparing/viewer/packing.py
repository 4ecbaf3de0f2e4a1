"""Texels in a page: planes of bytes, each predicted from what is unpacked before it, so that the rest deflates well.

A plane holds one byte of every texel of a level. A prediction is a weighted sum, by least squares, of neighbours above
and to the left; of the plane of the same texture that comes first; of the same plane of the stack before; and of the
mean of four texels of the finer level. Weights are whole numbers over 2^12, so that a browser unpacks the same bytes.
unpacking.js is the other half of this file.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.uint8]
"""(h + 2, w + 2): bytes within a border of zeros."""

Feature = tuple[Plane, int, int]
"""A plane, and how far below and to the right of the predicted byte it is looked at."""

FIRST = 1
"""The plane of a texture that others are predicted from: green, of colours."""

_SHIFT = 12
_BEFORE = ((0, -1), (-1, 0), (-1, -1), (-1, 1))
_OTHER_CHANNEL = ((0, 0), (0, -1), (-1, 0))
_OTHER_STACK = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
_ROWS = 64  # of a plane, about, that its weights are fitted to


@dataclass(frozen=True)
class Texels:
    """What a stack is unpacked to.

    Args:
        kind: stacks of one kind have the same channels in the same textures, and one may predict the next.
        levels: finest first; of each the textures, (h, w, B) bytes of texels.
    """

    kind: str
    levels: Sequence[Sequence[NDArray[np.uint8]]]


def packed(stacks: Sequence[Texels]) -> dict[str, Any]:
    """`data`, all that predictions leave, deflated, in base64; `weights`, a list of whole numbers for each plane.

    Planes follow each other stack by stack, level by level, texture by texture, FIRST before the others.
    """
    # Runs alone: what is left has no other patterns, and looking for them takes most of the time.
    deflate, weights = zlib.compressobj(6, zlib.DEFLATED, 15, 9, zlib.Z_RLE), []
    parts = []
    for plane, features in _predicted(stacks):
        chosen, left = _left(plane, features)
        weights.append(chosen)
        parts.append(deflate.compress(left.tobytes()))
    data = base64.b64encode(b"".join([*parts, deflate.flush()])).decode("ascii")
    return {"data": data, "weights": weights}


def _predicted(stacks: Sequence[Texels]) -> Iterator[tuple[Plane, list[Feature]]]:
    """Every plane with what predicts it."""
    before: list[list[list[Plane]]] = []
    kind = ""
    for stack in stacks:
        made: list[list[list[Plane]]] = []
        for level, textures in enumerate(stack.levels):
            made.append([[np.pad(texels[..., byte], 1) for byte in range(texels.shape[-1])] for texels in textures])
            for texture, planes in enumerate(made[level]):
                for byte in [FIRST, *(each for each in range(len(planes)) if each != FIRST)]:
                    plane = planes[byte]
                    features = [(plane, *at) for at in _BEFORE]
                    if byte != FIRST:
                        features += [(planes[FIRST], *at) for at in _OTHER_CHANNEL]
                    if kind == stack.kind and level < len(before):
                        other = before[level][texture][byte]
                        features += [(other, *at) for at in _OTHER_STACK] if other.shape == plane.shape else []
                    if level:
                        features += [(each, 0, 0) for each in _halved(made[level - 1][texture][byte], plane)]
                    yield plane, features
        before, kind = made, stack.kind


def _halved(finer: Plane, plane: Plane) -> list[Plane]:
    """Means of four texels where both sides are halved exactly, else nothing."""
    height, width = (side - 2 for side in plane.shape)
    if finer.shape != (2 * height + 2, 2 * width + 2):
        return []
    inner = finer[1:-1, 1:-1].astype(np.uint16)
    mean = (inner[::2, ::2] + inner[::2, 1::2] + inner[1::2, ::2] + inner[1::2, 1::2] + 2) >> 2
    return [np.pad(mean.astype(np.uint8), 1)]


def _left(plane: Plane, features: Sequence[Feature]) -> tuple[list[int], NDArray[np.uint8]]:
    """The weights of features, and (h, w) what their sum leaves of a plane, modulo 256."""
    height, width = (side - 2 for side in plane.shape)
    seen = [each[1 + down : 1 + down + height, 1 + right : 1 + right + width] for each, down, right in features]
    wanted, rows = plane[1:-1, 1:-1], slice(None, None, max(1, height // _ROWS))
    some = np.stack([each[rows].ravel() for each in seen]).astype(np.float64)
    squares = some @ some.T
    squares[np.diag_indices(len(squares))] += 0.5 * some.shape[1]
    weights = np.rint(np.linalg.solve(squares, some @ wanted[rows].ravel()) * (1 << _SHIFT)).astype(np.int32)
    total = np.full((height, width), 1 << (_SHIFT - 1), np.int32)
    for weight, each in zip(weights, seen, strict=True):
        total += weight * each.astype(np.int32)
    return weights.tolist(), wanted - np.clip(total >> _SHIFT, 0, 255).astype(np.uint8)
