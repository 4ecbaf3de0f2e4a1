"""Texels to the bytes that graphics cards sample and back: plain, half-float and block-compressed.

Blocks are 4 x 4 texels; a level whose sides are not multiples of 4 is continued by its last row and column, which
nobody samples. The native core makes and reads the blocks (`csrc/blocks`), of texels that nobody rounded before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.base import memory
from mipbake.source.images.gpu_format import GpuFormat, GpuTexture
from mipbake.source.images.quantise import dequantised

Texels = NDArray[np.generic]

Weigh: TypeAlias = Callable[[int, slice], NDArray[np.float32]]
"""Gives, for some rows of a level, (rows, W, C): what a squared error of each channel of each texel counts."""

_CHANNELS = {"bc4": 1, "bc5": 2}
"""Channels of texels that the core takes and gives; 4 for other blocks."""

_SIDE = 4

_AT_ONCE = 1 << 18
"""Texels whose blocks are made or read together."""


def to_blocks(levels: Sequence[Texels], made: GpuFormat, weigh: Weigh | None = None) -> tuple[bytes, ...]:
    """(H, W, C) texels of every level to their bytes.

    Args:
        levels: float32 from 0 to 1, or uint8, for blocks; float16 for half floats, uint8 for others; C no more than the
            channels of the format. A missing alpha is 1; one channel fills all colours of a format that has more.
        weigh: of their channels; None where all errors count the same. Only blocks are chosen by it.
    """
    if made.side == 1:
        return tuple(np.ascontiguousarray(widened(level, made.channels)).tobytes() for level in levels)
    return tuple(
        b"".join(
            _encoded(level[rows], made, None if weigh is None else weigh(index, rows))
            for rows in _strips(*level.shape[:2])
        )
        for index, level in enumerate(levels)
    )


def _encoded(level: Texels, made: GpuFormat, given: NDArray[np.float32] | None) -> bytes:
    kind = _kind(made)
    count = level.shape[2]
    values = np.ascontiguousarray(dequantised(widened(level, _CHANNELS.get(kind, 4))), np.float32)
    weights = None if given is None and values.shape[2] == count else np.ones_like(values)
    if weights is not None:
        if given is not None:
            weights[:] = widened(given, values.shape[2])
        if values.shape[2] > max(count, 3):
            weights[..., 3] = float(made.srgb or kind == "uastc")  # nobody asks what the alpha of data is
    blocks = np.empty((made.level_size(values.shape[1], values.shape[0]) // made.block, made.block), np.uint8)
    _native.encode_blocks(kind, values, weights, blocks)
    return blocks.tobytes()


def _kind(made: GpuFormat) -> str:
    """What the core calls a format of blocks."""
    return made.name.partition("_")[0].lower()


def _strips(height: int, width: int) -> list[slice]:
    """The rows of a level in whole blocks, some _AT_ONCE texels at a time: blocks know nothing of each other."""
    step = _SIDE * max(1, _AT_ONCE // (_SIDE * width))
    return [slice(start, min(height, start + step)) for start in range(0, height, step)]


def from_blocks(texture: GpuTexture) -> list[Texels]:
    """(H, W, C) texels of every level: float32 from 0 to 1 of blocks, float16 of half floats, uint8 of others; C the
    channels of the format.

    Blocks that no encoder writes are transparent black, as on graphics cards.
    """
    return [level[...] for level in levels_of(texture)]


def levels_of(texture: GpuTexture, channels: int | None = None) -> list[StoredLevel]:
    """The levels of a texture, of which no more is decoded than is read. `channels`: how many are wanted; None: all."""
    both = zip(texture.levels, texture.sizes, strict=True)
    return [StoredLevel(data, texture.format, size, channels) for data, size in both]


class StoredLevel:
    """A level as its bytes. Indexing it, with `...` or with rows and columns, gives texels as `from_blocks` has them.

    Attributes:
        shape: (H, W, C).
    """

    def __init__(self, data: bytes, made: GpuFormat, size: tuple[int, int], channels: int | None) -> None:
        self._data, self._made = data, made
        self.shape = (size[1], size[0], made.channels if channels is None else channels)

    def __getitem__(self, at: Any) -> Texels:
        """The texels of an index of an array of that shape, which reads whole levels; of (rows, columns), (...) int64
        each, only the blocks that hold them."""
        made = self._made
        height, width, channels = self.shape
        if made.side == 1:
            kind = np.dtype(np.float16 if made.is_float else np.uint8)
            return np.asarray(np.frombuffer(self._data, kind).reshape(height, width, -1)[..., :channels][at])
        blocks = np.frombuffer(self._data, np.uint8).reshape(-1, made.block)
        if not (isinstance(at, tuple) and all(isinstance(each, np.ndarray) for each in at)):
            out = memory.empty(self.shape)
            across, begin = -(-width // _SIDE), 0
            for rows in _strips(height, width):
                end = begin + across * -(-(rows.stop - rows.start) // _SIDE)
                out[rows] = _decoded(blocks[begin:end], made, rows.stop - rows.start, width)[..., :channels]
                begin = end
            return np.asarray(out[at])
        rows, columns = at
        needed, place = np.unique(rows // _SIDE * -(-width // _SIDE) + columns // _SIDE, return_inverse=True)
        found = _decoded(np.ascontiguousarray(blocks[needed]), made, _SIDE, _SIDE * len(needed))
        return found[rows % _SIDE, _SIDE * place.reshape(rows.shape) + columns % _SIDE, :channels]


def _decoded(blocks: NDArray[np.uint8], made: GpuFormat, height: int, width: int) -> NDArray[np.float32]:
    kind = _kind(made)
    values = np.empty((height, width, _CHANNELS.get(kind, 4)), np.float32)
    _native.decode_blocks(kind, blocks, values)
    return values[..., made.decoded_channels]


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
