"""DDS files with the header of Direct3D 10: a texture of any DXGI format with its levels, written and read."""

from __future__ import annotations

import struct

from mipbake.errors import InputError
from mipbake.io.gpu_format import GPU_FORMATS, GpuTexture, level_size

MAGIC = b"DDS "
_HEADER = struct.Struct("<7I44s8I4I I")  # DDS_HEADER: sizes, 11 reserved, DDS_PIXELFORMAT, caps, reserved
_DX10 = struct.Struct("<5I")

_FLAGS = 0x1 | 0x2 | 0x4 | 0x1000 | 0x20000  # caps, height, width, pixel format, mipmap count
_PITCH, _LINEAR_SIZE = 0x8, 0x80000
_CAPS = 0x1000  # texture
_CAPS_LEVELS = 0x8 | 0x400000  # complex, mipmap
_FOUR_CC = 0x4
_TEXTURE_2D = 3
_CUBE = 0x4  # D3D11_RESOURCE_MISC_TEXTURECUBE


def encoded(texture: GpuTexture) -> bytes:
    """The file. What stands beside the levels has no place in it."""
    made = texture.format
    compressed = made.side > 1
    first = len(texture.levels[0]) if compressed else made.block * texture.width
    caps = _CAPS | (_CAPS_LEVELS if len(texture.levels) > 1 else 0)
    header = _HEADER.pack(
        _HEADER.size,
        _FLAGS | (_LINEAR_SIZE if compressed else _PITCH),
        texture.height,
        texture.width,
        first,
        0,
        len(texture.levels),
        bytes(44),
        *(32, _FOUR_CC, int.from_bytes(b"DX10", "little"), 0, 0, 0, 0, 0),
        *(caps, 0, 0, 0),
        0,
    )
    return MAGIC + header + _DX10.pack(made.dxgi, _TEXTURE_2D, 0, 1, 0) + b"".join(texture.levels)


def decoded(data: bytes, name: str) -> GpuTexture:
    """The texture of a file; InputError, which calls it `name`, where it is broken or of a kind that is not read."""
    if data[:4] != MAGIC or len(data) < 4 + _HEADER.size + _DX10.size:
        raise InputError(f"{name} is not a DDS file with a Direct3D 10 header")
    fields = _HEADER.unpack_from(data, 4)
    height, width, count, four_cc = fields[2], fields[3], max(1, fields[6]), fields[10]
    if four_cc != int.from_bytes(b"DX10", "little"):
        raise InputError(f"{name} has an older DDS header: expected the header of Direct3D 10")
    dxgi, dimension, flags, layers, _ = _DX10.unpack_from(data, 4 + _HEADER.size)
    made = next((each for each in GPU_FORMATS.values() if dxgi and each.dxgi == dxgi), None)
    if made is None:
        known = ", ".join(name for name, each in GPU_FORMATS.items() if each.dxgi)
        raise InputError(f"{name} has the DXGI format {dxgi}: expected one of {known}")
    most = max(width, height).bit_length()
    if dimension != _TEXTURE_2D or flags & _CUBE or layers != 1 or not (width and height) or count > most:
        raise InputError(f"{name} is not a single two-dimensional texture with its levels")
    at, levels = 4 + _HEADER.size + _DX10.size, []
    for index in range(count):
        size = made.level_size(*level_size(width, height, index))
        if at + size > len(data):
            raise InputError(f"{name} ends within level {index}: it is not complete")
        levels.append(data[at : at + size])
        at += size
    return GpuTexture(made, width, height, tuple(levels), {})
