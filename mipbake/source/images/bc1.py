"""BC1 blocks: 4 x 4 texels as two colours of 5, 6 and 5 bits, and 2 bits a texel between them.

The line of colours begins along the greatest spread of a block's texels. Then ends and texels are fitted to each other
in turns, by least squares.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Integers = NDArray[np.int32]

_AT_ONCE = 1 << 13
"""So many blocks are made at a time, which takes a few kilobytes for each."""

_TURNS = 4  # a guess: more are worth a hundredth of a decibel

_TOP = np.array([31, 63, 31], np.float32)  # the greatest value of each channel's bits

_SHARES = np.array([1, 0, 2 / 3, 1 / 3], np.float32)
"""Of the first end, in what each code stands for."""


def compressed(level: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W, 3) texels, sides multiples of 4, to (H / 4 * W / 4, 8) bytes, row by row."""
    rows, columns = level.shape[0] // 4, level.shape[1] // 4
    texels = level.reshape(rows, 4, columns, 4, 3).swapaxes(1, 2).reshape(-1, 16, 3)
    return np.concatenate([_blocks(part) for part in np.array_split(texels, -(-len(texels) // _AT_ONCE))])


def _blocks(texels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    wanted = texels.astype(np.float32)
    ends = _spread(wanted)
    best, codes, least = _matched(ends, wanted)
    for _ in range(_TURNS):
        tried, found, error = _matched(_fitted(codes, wanted, best), wanted)
        better = error < least
        best[better], codes[better], least[better] = tried[better], found[better], error[better]
    return _packed(best, codes)


def _spread(wanted: Array) -> Array:
    """(N, 2, 3) colours at the ends of each block's texels, along the direction in which they spread most."""
    mean = wanted.mean(1, keepdims=True)
    off = wanted - mean
    axis = np.linalg.eigh(np.swapaxes(off, 1, 2) @ off)[1][..., -1:]
    along = off @ axis
    ends = np.stack([along.max(1), along.min(1)], 1)
    return np.asarray(mean + ends * np.swapaxes(axis, 1, 2), np.float32)


def _fitted(codes: Integers, wanted: Array, before: Integers) -> Array:
    """(N, 2, 3) ends with the least square error for codes; as before where all texels have one code."""
    share = np.stack([_SHARES[codes], 1 - _SHARES[codes]], 1)  # (N, 2, 16)
    normal = share @ np.swapaxes(share, 1, 2)
    a, b, c = normal[:, 0, 0], normal[:, 0, 1], normal[:, 1, 1]
    determinant = a * c - b * b
    sums = share @ wanted
    solvable = (determinant > 1e-3)[:, None, None]  # where it is not 0, it is 1 / 81 or more
    adjugate = np.stack([np.stack([c, -b], -1), np.stack([-b, a], -1)], 1)
    solved = adjugate @ sums / np.where(solvable, determinant[:, None, None], 1)
    return np.where(solvable, solved, _decoded(before)).astype(np.float32)


def _matched(ends: Array, wanted: Array) -> tuple[Integers, Integers, Array]:
    """Ends rounded to their bits, the nearest code of each texel, and the square error of each block."""
    rounded = np.clip(np.rint(ends * (_TOP / 255)), 0, _TOP).astype(np.int32)
    decoded = _decoded(rounded)
    palette = decoded[:, :1] * _SHARES[:, None] + decoded[:, 1:] * (1 - _SHARES[:, None])  # (N, 4, 3)
    errors = np.square(wanted[:, :, None] - palette[:, None]).sum(-1)
    codes = errors.argmin(-1).astype(np.int32)
    return rounded, codes, np.asarray(errors.min(-1).sum(-1), np.float32)


def _decoded(ends: Integers) -> Array:
    """Colours from 0 to 255 that bits stand for: their highest bits are repeated below them."""
    five, six = (ends << 3) | (ends >> 2), (ends << 2) | (ends >> 4)
    return np.where(_TOP == 31, five, six).astype(np.float32)


def _packed(ends: Integers, codes: Integers) -> NDArray[np.uint8]:
    words = ends @ np.array([1 << 11, 1 << 5, 1], np.int32)
    # The greater word comes first: the other order means three colours and black.
    turned = words[:, 0] < words[:, 1]
    words[turned] = words[turned, ::-1]
    codes = np.where(turned[:, None], codes ^ 1, codes)
    codes[words[:, 0] == words[:, 1]] = 0
    packed = (codes << 2 * np.arange(16)).astype(np.uint32).sum(1, dtype=np.uint32)
    return np.concatenate([words.astype("<u2").view(np.uint8), packed.astype("<u4")[:, None].view(np.uint8)], 1)
