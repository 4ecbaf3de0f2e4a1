"""Texels to the bytes that graphics cards sample and back: plain, half-float and block-compressed.

Blocks are 4 x 4 texels; a level whose sides are not multiples of 4 is continued by its last row and column, which
nobody samples. The larger encoders come from other projects: etcpak (BC7) and Basis Universal (UASTC).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.errors import InputError
from mipbake.base.messages import told_by
from mipbake.base.publish import temporary_folder, write_temporary
from mipbake.source.images import bc1, bc7, dds, uastc
from mipbake.source.images.gpu_format import GpuFormat, GpuTexture, level_size

Texels = NDArray[np.generic]
Bytes = NDArray[np.uint8]

_AT_ONCE = 1 << 18
"""Texels whose blocks are made or read together."""

_BC4_CODES = np.array([1, 7, 6, 5, 4, 3, 2, 0], np.uint8)
"""What BC4 stores for each of the eight values from the least to the greatest."""


def to_blocks(levels: Sequence[Texels], made: GpuFormat) -> tuple[bytes, ...]:
    """(H, W, C) texels of every level to their bytes.

    Args:
        levels: uint8, or float16 for half-float formats; C no more than the channels of the format. A missing alpha
            is 1; one channel fills all colours where the format has no format of one channel.
    """
    if made.side == 1:
        return tuple(np.ascontiguousarray(widened(level, made.channels)).tobytes() for level in levels)
    if made.name.startswith("UASTC"):
        return uastc.compressed([widened(np.asarray(level, np.uint8), 4) for level in levels], made)
    wide = 4 if made.name.startswith("BC7") else made.channels
    counts = [len(_strips(*level.shape[:2])) for level in levels]
    strips = (
        np.asarray(widened(_padded(np.asarray(level[rows], np.uint8)), wide), np.uint8)
        for level in levels
        for rows in _strips(*level.shape[:2])
    )
    if made.name.startswith("BC7"):
        done = bc7.compressed(strips, exactly_opaque=made.srgb)
    else:
        done = (_small(strip, made) for strip in strips)
    return tuple(b"".join(islice(done, count)) for count in counts)


def _strips(height: int, width: int) -> list[slice]:
    """The rows of a level in whole blocks, some _AT_ONCE texels at a time: blocks know nothing of each other."""
    step = 4 * max(1, _AT_ONCE // (4 * width))
    return [slice(start, min(height, start + step)) for start in range(0, height, step)]


def from_blocks(texture: GpuTexture) -> list[Texels]:
    """(H, W, C) texels of every level, uint8 or float16, C the channels of the format.

    Raises:
        InputError: blocks that no encoder writes. OutputError: no place for temporary files.
    """
    made = texture.format
    sizes = [level_size(texture.width, texture.height, index) for index in range(len(texture.levels))]
    sized = list(zip(texture.levels, sizes, strict=True))
    if made.side == 1:
        kind = np.dtype(np.float16 if made.is_float else np.uint8)
        return [np.frombuffer(data, kind).reshape(height, width, -1) for data, (width, height) in sized]
    if made.name.startswith("UASTC"):
        return [level[..., made.decoded_channels] for level in uastc.decompressed(texture)]
    large = sum(width * height > _AT_ONCE for width, height in sizes)
    out = [_by_strips(data, made, width, height) for data, (width, height) in sized[:large]]
    if large < len(sizes):
        out += _decoded(GpuTexture(made, *sizes[large], texture.levels[large:], {}))
    return out


def _by_strips(data: bytes, made: GpuFormat, width: int, height: int) -> Texels:
    """One level of blocks, some of its rows at a time."""
    out = memory.empty((height, width, made.channels), np.uint8)
    start = 0
    for rows in _strips(height, width):
        part = out[rows]
        size = made.level_size(width, len(part))
        part[...] = _decoded(GpuTexture(made, width, len(part), (data[start : start + size],), {}))[0]
        start += size
    return out


def _decoded(texture: GpuTexture) -> list[Texels]:
    """(H, W, C) texels of every level of blocks of BC1 to BC7."""
    made = texture.format
    if not made.name.startswith(("BC4", "BC5")):
        return [level[..., : made.channels] for level in _by_image_library(texture)]
    sizes = (level_size(texture.width, texture.height, index) for index in range(len(texture.levels)))
    return [_red_green(data, made, *size) for data, size in zip(texture.levels, sizes, strict=True)]


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


def _padded(level: Bytes) -> Bytes:
    height, width = level.shape[:2]
    return np.pad(level, ((0, -height % 4), (0, -width % 4), (0, 0)), mode="edge")


def _small(level: Bytes, made: GpuFormat) -> bytes:
    """A level of BC1, BC4 or BC5."""
    if made.name.startswith("BC1"):
        return bc1.compressed(level[..., :3]).tobytes()
    return np.concatenate([_bc4(level[..., i]) for i in range(made.channels)], 1).tobytes()


def _bc4(level: Bytes) -> Bytes:
    """(H, W) texels, sides multiples of 4, to (H / 4 * W / 4, 8) bytes of BC4, row by row: in each block the least and
    the greatest value, and 3 bits a texel between them. Two blocks of BC4 are one of BC5."""
    rows, columns = level.shape[0] // 4, level.shape[1] // 4
    texels = level.reshape(rows, 4, columns, 4).swapaxes(1, 2).reshape(-1, 16).astype(np.int32)
    greatest, least = texels.max(1), texels.min(1)
    span = np.maximum(greatest - least, 1)[:, None]
    codes = _BC4_CODES[(7 * (texels - least[:, None]) + span // 2) // span]
    codes[greatest == least] = 0  # such a block has other values between its ends, but both ends are right
    bits = codes[..., None] >> np.arange(3, dtype=np.uint8) & 1
    ends = np.stack([greatest, least], 1).astype(np.uint8)
    return np.concatenate([ends, np.packbits(bits.reshape(-1, 48), axis=1, bitorder="little")], 1)


def _red_green(data: bytes, made: GpuFormat, width: int, height: int) -> Bytes:
    """A level of BC4 or BC5."""
    blocks = np.frombuffer(data, np.uint8).reshape(-1, made.block)
    parts = [_bc4_values(blocks[:, start : start + 8]) for start in range(0, made.block, 8)]
    texels = np.stack(parts, -1)  # (blocks, 4, 4, C)
    rows, columns = -(-height // 4), -(-width // 4)
    image = texels.reshape(rows, columns, 4, 4, -1).swapaxes(1, 2).reshape(4 * rows, 4 * columns, -1)
    return np.ascontiguousarray(image[:height, :width])


def _bc4_values(blocks: Bytes) -> Bytes:
    """(N, 8) blocks of BC4 to (N, 4, 4): two ends, and 3 bits a texel between them."""
    first, second = (blocks[:, i].astype(np.int32) for i in (0, 1))
    steps = np.arange(1, 7)
    wide = (first[:, None] * (7 - steps) + second[:, None] * steps) / 7
    narrow = (first[:, None] * (5 - steps[:4]) + second[:, None] * steps[:4]) / 5
    ends = np.broadcast_to([0.0, 255.0], (len(blocks), 2))
    between = np.where((first > second)[:, None], wide, np.concatenate([narrow, ends], 1))
    table = np.concatenate([first[:, None], second[:, None], between], 1)
    bits = np.unpackbits(blocks[:, 2:], axis=1, bitorder="little").reshape(len(blocks), 16, 3)
    index = bits @ np.array([1, 2, 4], np.uint8)
    values = np.take_along_axis(table, index.astype(np.int64), 1)
    return np.floor(values + 0.5).astype(np.uint8).reshape(-1, 4, 4)


def _by_image_library(texture: GpuTexture) -> list[Texels]:
    """Levels of BC1 and BC7 as OpenImageIO's reader of DDS files decodes them."""
    import OpenImageIO

    with temporary_folder() as folder:
        path = folder / "levels.dds"
        write_temporary(path, dds.encoded(texture))
        source = OpenImageIO.ImageInput.open(str(path))
        if source is None:
            raise InputError(f"texels of {texture.format.name} cannot be decoded ({told_by(OpenImageIO.geterror)})")
        try:
            levels: list[Texels] = []
            for index in range(len(texture.levels)):
                width, height = level_size(texture.width, texture.height, index)
                pixels = source.read_image(0, index, 0, 4, "uint8")
                if pixels is None:
                    raise InputError(f"level {index} of {texture.format.name} cannot be decoded: its blocks are broken")
                levels.append(np.asarray(pixels, np.uint8).reshape(height, width, -1))
            return levels
        finally:
            source.close()
