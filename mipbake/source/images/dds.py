"""DDS files with the header of Direct3D 10: a texture of any DXGI format with its levels, written and read. Of older
headers those are read whose colours are multiplied by alpha, because OpenImageIO overflows where it divides them."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from mipbake.base.errors import InputError
from mipbake.source.images.gpu_format import READ_FORMATS, GpuTexture, level_size

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
_CAPS_CUBE, _CAPS_VOLUME = 0x200, 0x200000
_TEXTURE_3D = 4

START = 4 + _HEADER.size + _DX10.size
"""Bytes of a file that `header` looks at."""

PREMULTIPLIED, OPAQUE, CUSTOM = 2, 3, 4
"""What alpha is, in the header of Direct3D 10. 0 is unknown, 1 is straight."""

_MULTIPLIED = {b"DXT2": 74, b"DXT4": 77}
"""Four letters of formats whose colours are multiplied by alpha, to the DXGI format of their blocks."""


@dataclass(frozen=True)
class Header:
    """What a header says.

    Args:
        width, height: of level 0. levels: how many. dxgi: the DXGI format; None for one that an older header has.
        alpha: what alpha is. several: what makes it more than one image, and how to get one; empty where it is one.
        size: of the header.
    """

    width: int
    height: int
    levels: int
    dxgi: int | None
    alpha: int
    several: str
    size: int


def header(data: bytes) -> Header | None:
    """The header that `START` bytes hold; None where they do not begin a DDS file."""
    if data[:4] != MAGIC or len(data) < 4 + _HEADER.size:
        return None
    fields = _HEADER.unpack_from(data, 4)
    letters, caps2 = fields[10].to_bytes(4, "little"), fields[17]
    dimension, misc, layers, alpha, size = 0, 0, 1, 0, 4 + _HEADER.size
    dxgi: int | None = None
    if letters == b"DX10":
        if len(data) < START:
            return None
        dxgi, dimension, misc, layers, alpha = _DX10.unpack_from(data, size)
        size = START
    elif letters in _MULTIPLIED:
        dxgi, alpha = _MULTIPLIED[letters], PREMULTIPLIED
    several = ""
    if caps2 & _CAPS_CUBE or misc & _CUBE:
        several = "a cube map: extract one face as an image of its own"
    elif caps2 & _CAPS_VOLUME or dimension == _TEXTURE_3D:
        several = "a 3D texture: extract one slice as an image of its own"
    elif layers > 1:
        several = f"an array of {layers} layers: extract one layer as an image of its own"
    return Header(fields[3], fields[2], max(1, fields[6]), dxgi, alpha & 7, several, size)


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
    found = header(data[:START])
    if found is None:
        raise InputError(f"{name} is not a DDS file with a whole header")
    if found.several:
        raise InputError(f"{name} holds {found.several}")
    if found.dxgi is None:
        raise InputError(f"{name} has an older DDS header: expected the header of Direct3D 10")
    width, height, count = found.width, found.height, found.levels
    made = next((each for each in READ_FORMATS.values() if found.dxgi and each.dxgi == found.dxgi), None)
    if made is None:
        known = ", ".join(name for name, each in READ_FORMATS.items() if each.dxgi)
        raise InputError(f"{name} has the DXGI format {found.dxgi}: expected one of {known}")
    if not (width and height) or count > max(width, height).bit_length():
        raise InputError(f"{name} declares {count} levels of {width} x {height} texels, which no texture has")
    at, levels = found.size, []
    for index in range(count):
        size = made.level_size(*level_size(width, height, index))
        if at + size > len(data):
            raise InputError(f"{name} ends within level {index}: it is not complete")
        levels.append(data[at : at + size])
        at += size
    return GpuTexture(made, width, height, tuple(levels), {})
