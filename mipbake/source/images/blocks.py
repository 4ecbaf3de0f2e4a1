"""Texels to the bytes that graphics cards sample and back: plain, half-float and block-compressed.

Blocks are 4 x 4 texels; a level whose sides are not multiples of 4 is continued by its last row and column, which
nobody samples. The native core makes and reads the blocks (`csrc/blocks`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.base import memory
from mipbake.source.images.gpu_format import GpuFormat, GpuTexture, level_size

Texels = NDArray[np.generic]

_CHANNELS = {"bc4": 1, "bc5": 2}
"""Channels of texels that the core takes and gives; 4 for other blocks."""

_AT_ONCE = 1 << 18
"""Texels whose blocks are made or read together: they are float32 meanwhile."""


def to_blocks(levels: Sequence[Texels], made: GpuFormat) -> tuple[bytes, ...]:
    """(H, W, C) texels of every level to their bytes.

    Args:
        levels: uint8, or float16 for half-float formats; C no more than the channels of the format. A missing alpha
            is 1; one channel fills all colours where the format has no format of one channel.
    """
    if made.side == 1:
        return tuple(np.ascontiguousarray(widened(level, made.channels)).tobytes() for level in levels)
    return tuple(b"".join(_encoded(level[rows], made) for rows in _strips(*level.shape[:2])) for level in levels)


def _encoded(level: Texels, made: GpuFormat) -> bytes:
    kind = _kind(made)
    values = np.divide(widened(level, _CHANNELS.get(kind, 4)), 255, dtype=np.float32)
    weights = None
    if level.shape[2] < 4 and kind in ("bc7", "uastc"):
        weights = np.ones_like(values)
        weights[..., 3] = float(made.srgb or kind == "uastc")  # nobody asks what the alpha of data is
    blocks = np.empty((made.level_size(values.shape[1], values.shape[0]) // made.block, made.block), np.uint8)
    _native.encode_blocks(kind, np.ascontiguousarray(values), weights, blocks)
    return blocks.tobytes()


def _kind(made: GpuFormat) -> str:
    """What the core calls a format of blocks."""
    return made.name.partition("_")[0].lower()


def _strips(height: int, width: int) -> list[slice]:
    """The rows of a level in whole blocks, some _AT_ONCE texels at a time: blocks know nothing of each other."""
    step = 4 * max(1, _AT_ONCE // (4 * width))
    return [slice(start, min(height, start + step)) for start in range(0, height, step)]


def from_blocks(texture: GpuTexture) -> list[Texels]:
    """(H, W, C) texels of every level, uint8 or float16, C the channels of the format.

    Blocks that no encoder writes are transparent black, as on graphics cards.
    """
    made = texture.format
    sizes = [level_size(texture.width, texture.height, index) for index in range(len(texture.levels))]
    sized = list(zip(texture.levels, sizes, strict=True))
    if made.side == 1:
        kind = np.dtype(np.float16 if made.is_float else np.uint8)
        return [np.frombuffer(data, kind).reshape(height, width, -1) for data, (width, height) in sized]
    return [_decoded(data, made, *size) for data, size in sized]


def _decoded(data: bytes, made: GpuFormat, width: int, height: int) -> Texels:
    """One level of blocks."""
    out = memory.empty((height, width, made.channels), np.uint8)
    kind, start = _kind(made), 0
    for rows in _strips(height, width):
        part = out[rows]
        values = np.empty((*part.shape[:2], _CHANNELS.get(kind, 4)), np.float32)
        size = made.level_size(width, len(part))
        blocks = np.frombuffer(data, np.uint8, size, start).reshape(-1, made.block)
        _native.decode_blocks(kind, blocks, values)
        part[...] = np.floor(values[..., made.decoded_channels] * 255 + 0.5)
        start += size
    return out


def widened(level: Texels, channels: int) -> Texels:
    """Texels with so many channels: one fills all colours, a second colour is followed by 0, alpha is 1."""
    count = level.shape[2]
    if count >= channels:
        return level
    one = np.asarray(255 if level.dtype == np.uint8 else 1, level.dtype)
    colours = np.repeat(level, 3, -1) if count == 1 else level
    if colours.shape[2] == 2:
        colours = np.concatenate([colours, np.zeros_like(colours[..., :1])], -1)
    alpha = np.full((*level.shape[:2], 1), one)
    return np.concatenate([colours, alpha], -1)[..., :channels]
