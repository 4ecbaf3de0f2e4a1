"""Texel formats that graphics cards sample, with what Vulkan, Direct3D and Khronos's descriptors call them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

_RGBSDA, _BC1, _BC2, _BC3, _BC4, _BC5, _BC7, _UASTC = 1, 128, 129, 130, 131, 132, 134, 166
"""Colour models of Khronos's data formats 1.3."""

_BC1_ALPHA = 1
_UASTC_RGB, _UASTC_RGBA, _UASTC_RRR, _UASTC_RRRG, _UASTC_RG = 0, 3, 4, 5, 6
_ALPHA = 15
_RGBA = (0, 1, 2, _ALPHA)
_LINEAR_ALPHA, _SIGNED, _FLOAT = 0x10, 0x40, 0x80
_ONE, _MINUS_ONE = 0x3F800000, 0xBF800000  # as float32
_BLOCK_UPPER = 0xFFFFFFFF

_UASTC_CHANNELS = {
    _UASTC_RRR: (0,),
    _UASTC_RG: (0, 1),
    _UASTC_RRRG: (0, 3),
    _UASTC_RGB: (0, 1, 2),
    _UASTC_RGBA: (0, 1, 2, 3),
}
"""What the blocks are declared to hold, to the channels of decoded texels that hold it: RRRG keeps green in alpha."""


@dataclass(frozen=True)
class GpuFormat:
    """What the bytes of a level are.

    Args:
        name: the name in Vulkan, without its prefix.
        vulkan, dxgi: VkFormat and DXGI_FORMAT; 0 where there is none, since it is transcoded before it is sampled.
        is_float: whether texels are half-float numbers; else they are 8-bit integers, before they are compressed.
        model: colour model of the descriptor. held: channels of its samples, which share the bits of a block evenly.
        side: texels of a block's side. block: bytes of a block.
        srgb: whether colours are sRGB-encoded.
    """

    name: str
    vulkan: int
    dxgi: int
    is_float: bool
    model: int
    side: int
    block: int
    srgb: bool
    held: tuple[int, ...]

    @property
    def samples(self) -> tuple[tuple[int, int, int, int, int], ...]:
        """Samples of the descriptor: the first bit in a block, how many there are, the channel with its flags, and what
        stands for the least and for the greatest number."""
        bits = 8 * self.block // len(self.held)
        low, high = (0, _BLOCK_UPPER) if self.side > 1 else (_MINUS_ONE, _ONE) if self.is_float else (0, 255)
        flags = dict.fromkeys(self.held, _SIGNED | _FLOAT if self.is_float else 0)
        if self.srgb and _ALPHA in flags:
            flags[_ALPHA] |= _LINEAR_ALPHA
        return tuple((i * bits, bits, channel | flags[channel], low, high) for i, channel in enumerate(self.held))

    @property
    def channels(self) -> int:
        """Channels that texels have, before they are compressed and after."""
        return len(self.decoded_channels)

    @property
    def decoded_channels(self) -> tuple[int, ...]:
        """Which channels of the texels that a decoder gives these are."""
        if self.model == _UASTC:
            return _UASTC_CHANNELS[self.held[0]]
        colours = 4 if self.held[0] == _BC1_ALPHA else 3
        blocks = {_BC1: colours, _BC2: 4, _BC3: 4, _BC4: 1, _BC5: 2, _BC7: 4}
        return tuple(range(blocks.get(self.model, len(self.held))))

    def level_size(self, width: int, height: int) -> int:
        """Bytes of a level."""
        return math.ceil(width / self.side) * math.ceil(height / self.side) * self.block


_ALL = (
    GpuFormat("R8_UNORM", 9, 61, False, _RGBSDA, 1, 1, False, _RGBA[:1]),
    GpuFormat("R8G8_UNORM", 16, 49, False, _RGBSDA, 1, 2, False, _RGBA[:2]),
    GpuFormat("R8G8B8A8_UNORM", 37, 28, False, _RGBSDA, 1, 4, False, _RGBA),
    GpuFormat("R8G8B8A8_SRGB", 43, 29, False, _RGBSDA, 1, 4, True, _RGBA),
    GpuFormat("R16_SFLOAT", 76, 54, True, _RGBSDA, 1, 2, False, _RGBA[:1]),
    GpuFormat("R16G16_SFLOAT", 83, 34, True, _RGBSDA, 1, 4, False, _RGBA[:2]),
    GpuFormat("R16G16B16A16_SFLOAT", 97, 10, True, _RGBSDA, 1, 8, False, _RGBA),
    GpuFormat("BC1_RGB_UNORM_BLOCK", 131, 71, False, _BC1, 4, 8, False, (0,)),
    GpuFormat("BC1_RGB_SRGB_BLOCK", 132, 72, False, _BC1, 4, 8, True, (0,)),
    GpuFormat("BC4_UNORM_BLOCK", 139, 80, False, _BC4, 4, 8, False, (0,)),
    GpuFormat("BC5_UNORM_BLOCK", 141, 83, False, _BC5, 4, 16, False, _RGBA[:2]),
    GpuFormat("BC7_UNORM_BLOCK", 145, 98, False, _BC7, 4, 16, False, (0,)),
    GpuFormat("BC7_SRGB_BLOCK", 146, 99, False, _BC7, 4, 16, True, (0,)),
    GpuFormat("UASTC_RG_UNORM_BLOCK", 0, 0, False, _UASTC, 4, 16, False, (_UASTC_RG,)),
    GpuFormat("UASTC_RGB_UNORM_BLOCK", 0, 0, False, _UASTC, 4, 16, False, (_UASTC_RGB,)),
    GpuFormat("UASTC_RGBA_UNORM_BLOCK", 0, 0, False, _UASTC, 4, 16, False, (_UASTC_RGBA,)),
    GpuFormat("UASTC_RGB_SRGB_BLOCK", 0, 0, False, _UASTC, 4, 16, True, (_UASTC_RGB,)),
    GpuFormat("UASTC_RGBA_SRGB_BLOCK", 0, 0, False, _UASTC, 4, 16, True, (_UASTC_RGBA,)),
)

GPU_FORMATS: Mapping[str, GpuFormat] = {each.name: each for each in _ALL}
"""The formats that are written, by name."""

_ONLY_READ = (
    GpuFormat("R8_SRGB", 15, 0, False, _RGBSDA, 1, 1, True, _RGBA[:1]),
    GpuFormat("R8G8_SRGB", 22, 0, False, _RGBSDA, 1, 2, True, _RGBA[:2]),
    GpuFormat("R8G8B8_UNORM", 23, 0, False, _RGBSDA, 1, 3, False, _RGBA[:3]),
    GpuFormat("R8G8B8_SRGB", 29, 0, False, _RGBSDA, 1, 3, True, _RGBA[:3]),
    GpuFormat("R16G16B16_SFLOAT", 90, 0, True, _RGBSDA, 1, 6, False, _RGBA[:3]),
    GpuFormat("BC1_RGBA_UNORM_BLOCK", 133, 71, False, _BC1, 4, 8, False, (_BC1_ALPHA,)),
    GpuFormat("BC1_RGBA_SRGB_BLOCK", 134, 72, False, _BC1, 4, 8, True, (_BC1_ALPHA,)),
    GpuFormat("BC2_UNORM_BLOCK", 135, 74, False, _BC2, 4, 16, False, (0,)),
    GpuFormat("BC2_SRGB_BLOCK", 136, 75, False, _BC2, 4, 16, True, (0,)),
    GpuFormat("BC3_UNORM_BLOCK", 137, 77, False, _BC3, 4, 16, False, (0,)),
    GpuFormat("BC3_SRGB_BLOCK", 138, 78, False, _BC3, 4, 16, True, (0,)),
    GpuFormat("UASTC_RRR_UNORM_BLOCK", 0, 0, False, _UASTC, 4, 16, False, (_UASTC_RRR,)),
    GpuFormat("UASTC_RRR_SRGB_BLOCK", 0, 0, False, _UASTC, 4, 16, True, (_UASTC_RRR,)),
    GpuFormat("UASTC_RRRG_UNORM_BLOCK", 0, 0, False, _UASTC, 4, 16, False, (_UASTC_RRRG,)),
    GpuFormat("UASTC_RRRG_SRGB_BLOCK", 0, 0, False, _UASTC, 4, 16, True, (_UASTC_RRRG,)),
    GpuFormat("UASTC_RG_SRGB_BLOCK", 0, 0, False, _UASTC, 4, 16, True, (_UASTC_RG,)),
)

READ_FORMATS: Mapping[str, GpuFormat] = {**GPU_FORMATS} | {each.name: each for each in _ONLY_READ}
"""The formats that files of others may have, by name."""


@dataclass(frozen=True)
class GpuTexture:
    """A two-dimensional texture: its format, the size of level 0, the bytes of every level, finest first, and what the
    container says beside them."""

    format: GpuFormat
    width: int
    height: int
    levels: tuple[bytes, ...]
    values: Mapping[str, bytes]

    def __post_init__(self) -> None:
        """ValueError where a level has not the bytes that its size and format take."""
        for index, (level, size) in enumerate(zip(self.levels, self.sizes, strict=True)):
            expected = self.format.level_size(*size)
            if len(level) != expected:
                raise ValueError(f"level {index} has {len(level)} bytes, {self.format.name} of its size has {expected}")

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """(width, height) of every level."""
        return tuple(level_size(self.width, self.height, index) for index in range(len(self.levels)))


def level_size(width: int, height: int, level: int) -> tuple[int, int]:
    """(width, height) of a level."""
    return max(1, width >> level), max(1, height >> level)
