"""KTX 2.0 files: header, data format descriptor, key-value data and levels, written and read.

The structure follows the KTX File Format Specification 2.0; descriptors follow the Khronos Data Format Specification
1.3. Levels come as the bytes that a GPU takes; the encoders turn texels into these bytes.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType

from mipbake.errors import InputError
from mipbake.io.gpu_format import READ_FORMATS, GpuFormat, GpuTexture, level_size

IDENTIFIER = bytes.fromhex("AB4B5458203230BB0D0A1A0A")
_HEADER = struct.Struct("<9I")  # vkFormat to supercompressionScheme
_INDEX = struct.Struct("<4I2Q")  # offset and length of descriptor, key-value data, supercompression global data
_LEVEL = struct.Struct("<3Q")  # offset, length, length when inflated
_START = len(IDENTIFIER) + _HEADER.size + _INDEX.size

NONE, ZSTANDARD = 0, 2
"""supercompressionScheme of levels in the specification: as they are, or a Zstandard stream each."""

MOST = 65536
"""Texels along a side; no graphics card has more, and a header that declares more is broken. The specification has no
limit."""

_ZSTANDARD_LEVEL = 15  # a guess; 18 is a third slower for 1 % less

_UNSPECIFIED, _BT709 = 0, 1  # primaries in the data format specification
_LINEAR, _SRGB = 1, 2  # transfer functions in the same specification
_DESCRIPTOR_VERSION = 2  # of the same specification


def encoded(texture: GpuTexture, supercompress: bool) -> bytes:
    """The file. Levels are Zstandard streams with `supercompress`."""
    made, levels = texture.format, list(texture.levels)
    stored = levels
    if supercompress:
        stored = [_zstandard().compress(level, _ZSTANDARD_LEVEL) for level in levels]
    descriptor = _descriptor(made)
    values = _values(texture.values)
    descriptor_at = _START + _LEVEL.size * len(levels)
    values_at = descriptor_at + len(descriptor)
    # Levels lie from the coarsest to the finest, so that a stream can be shown before it ends.
    alignment = 1 if supercompress else math.lcm(made.block, 4)
    place, places, body = values_at + len(values), [0] * len(levels), bytearray()
    for index in reversed(range(len(levels))):
        padding = -place % alignment
        body += bytes(padding) + stored[index]
        places[index] = place + padding
        place += padding + len(stored[index])
    scheme = ZSTANDARD if supercompress else NONE
    header = _HEADER.pack(
        made.vulkan, made.unit, texture.width, texture.height, 0, 0, 1, len(levels), scheme
    )  # fmt: skip
    index_ = _INDEX.pack(descriptor_at, len(descriptor), values_at if values else 0, len(values), 0, 0)
    table = b"".join(
        _LEVEL.pack(at, len(packed), len(level)) for at, packed, level in zip(places, stored, levels, strict=True)
    )
    return IDENTIFIER + header + index_ + table + descriptor + values + bytes(body)


def _descriptor(made: GpuFormat) -> bytes:
    """One basic descriptor block, the same with supercompression and without.

    Early editions of KTX 2.0 wanted bytesPlane0 to be 0 in supercompressed files; later ones want what stands here, and
    Babylon.js of July 2026 reads nothing else (its pull request 18793).
    """
    samples = b"".join(
        struct.pack("<HBB4B2I", s.offset, s.length - 1, s.channel, 0, 0, 0, 0, s.lower, s.upper) for s in made.samples
    )
    size = 24 + len(samples)
    # KHR_texture_basisu wants unspecified primaries for anything but colours.
    primaries = _BT709 if made.srgb or made.vulkan else _UNSPECIFIED
    transfer = _SRGB if made.srgb else _LINEAR
    basic = struct.pack("<IHH4B", 0, _DESCRIPTOR_VERSION, size, made.model, primaries, transfer, 0)
    basic += bytes([made.side - 1, made.side - 1, 0, 0])
    basic += bytes([made.block, 0, 0, 0, 0, 0, 0, 0])
    return struct.pack("<I", 4 + size) + basic + samples


def _values(values: Mapping[str, bytes]) -> bytes:
    out = bytearray()
    for key in sorted(values):
        entry = key.encode() + b"\0" + values[key]
        out += struct.pack("<I", len(entry)) + entry + bytes(-len(entry) % 4)
    return bytes(out)


@dataclass(frozen=True)
class Outline:
    """What the header of a file tells, whatever its texels are.

    Args:
        texels: what they are stored as. srgb: whether colours are encoded so.
        levels: (width, height) of each, finest first.
        readable: whether `decoded` reads files of this kind.
    """

    texels: str
    srgb: bool
    levels: tuple[tuple[int, int], ...]
    readable: bool


def outline(data: bytes, name: str) -> Outline:
    """What the header of a file tells; InputError, which calls it `name`, where it is not a KTX 2 file or is broken."""
    try:
        head = _head(data, name)
    except struct.error as error:
        raise InputError(f"{name} ends within its header: it is not a complete KTX 2 file") from error
    _check_size(head, name, 0)  # 0 levels are to be made by who loads the file
    other = _MODELS.get(head.model, f"colour model {head.model}") if not head.vulkan else f"Vulkan format {head.vulkan}"
    return Outline(
        other if head.made is None else head.made.name,
        head.transfer == _SRGB,
        tuple(level_size(head.width, head.height, index) for index in range(max(1, head.count))),
        head.made is not None and not head.several and head.scheme in (NONE, ZSTANDARD),
    )


ETC1S = "ETC1S"
_MODELS = {163: ETC1S, 166: "UASTC"}
"""Colour models of textures that are transcoded when they are loaded, and have no Vulkan format."""

_ALPHA_SLICE = 15
"""Channel of the second sample of ETC1S where it is alpha, in the specification."""


def has_alpha_slice(data: bytes) -> bool:
    """Whether a file of ETC1S, whose header `outline` has read, has alpha beside its colours."""
    descriptor_at, length, *_ = _INDEX.unpack_from(data, len(IDENTIFIER) + _HEADER.size)
    second = descriptor_at + 4 + 24 + 16  # total size, basic block, first sample
    return bool(length >= 4 + 24 + 32 and len(data) > second + 3 and data[second + 3] & 15 == _ALPHA_SLICE)


@dataclass(frozen=True)
class _Head:
    """The fields of a header; `several`: whether there are layers, faces or slices; `made`: None for other formats."""

    vulkan: int
    width: int
    height: int
    several: bool
    count: int
    scheme: int
    model: int
    transfer: int
    made: GpuFormat | None


def _head(data: bytes, name: str) -> _Head:
    if data[: len(IDENTIFIER)] != IDENTIFIER:
        raise InputError(f"{name} is not a KTX 2 file: it does not begin like one")
    vulkan, _, width, height, depth, layers, faces, count, scheme = _HEADER.unpack_from(data, len(IDENTIFIER))
    descriptor_at, *_ = _INDEX.unpack_from(data, len(IDENTIFIER) + _HEADER.size)
    model, _, transfer = struct.unpack_from("<3B", data, descriptor_at + 12)
    (channel,) = struct.unpack_from("<B", data, descriptor_at + 31)
    made = next((f for f in READ_FORMATS.values() if _is(f, vulkan, model, transfer, channel)), None)
    several = bool(depth or layers or faces != 1)
    return _Head(vulkan, width, height, several, count, scheme, model, transfer, made)


def _check_size(head: _Head, name: str, least: int) -> None:
    """InputError where no texture is so large, or has so many levels, `least` or more."""
    if not head.width or not head.height:
        raise InputError(
            f"{name} is not a single two-dimensional texture: expected one without layers, faces and depth"
        )
    if max(head.width, head.height) > MOST:
        raise InputError(f"{name} declares {head.width} x {head.height} texels: expected {MOST} along a side at most")
    most = max(head.width, head.height).bit_length()
    if not least <= head.count <= most:
        raise InputError(f"{name} declares {head.count} levels: {head.width} x {head.height} texels have 1 to {most}")


@dataclass(frozen=True)
class StoredTexture:
    """A texture as a file stores it: like `GpuTexture`, with levels that may be Zstandard streams still."""

    format: GpuFormat
    width: int
    height: int
    levels: tuple[bytes, ...]
    values: Mapping[str, bytes]
    supercompressed: bool


def stored(data: bytes, name: str) -> StoredTexture:
    """What is in a file, nothing inflated; InputError as for `decoded`, except for streams that are broken."""
    try:
        return _stored(data, name)
    except struct.error as error:
        raise InputError(f"{name} ends within its header: it is not a complete KTX 2 file") from error


def decoded(data: bytes, name: str) -> GpuTexture:
    """The texture of a file; InputError, which calls it `name`, where it is broken or of a kind that is not read."""
    found = stored(data, name)
    levels = found.levels
    if found.supercompressed:
        sizes = (found.format.level_size(*level_size(found.width, found.height, i)) for i in range(len(levels)))
        levels = tuple(_inflated(*each, name, i) for i, each in enumerate(zip(levels, sizes, strict=True)))
    return GpuTexture(found.format, found.width, found.height, levels, found.values)


def _stored(data: bytes, name: str) -> StoredTexture:
    head = _head(data, name)
    made, width, height = head.made, head.width, head.height
    if made is None:
        raise InputError(
            f"{name} has the Vulkan format {head.vulkan} with colour model {head.model}: expected one of "
            f"{', '.join(READ_FORMATS)}"
        )
    if head.several:
        raise InputError(
            f"{name} is not a single two-dimensional texture: expected one without layers, faces and depth"
        )
    _check_size(head, name, 1)
    if head.scheme not in (NONE, ZSTANDARD):
        raise InputError(f"{name} has the supercompression scheme {head.scheme}: expected 0 (none) or 2 (Zstandard)")
    *_, values_at, values_length, _, _ = _INDEX.unpack_from(data, len(IDENTIFIER) + _HEADER.size)
    levels = []
    for index in range(head.count):
        at, length, inflated = _LEVEL.unpack_from(data, _START + _LEVEL.size * index)
        levels.append(data[at : at + length])
        expected = made.level_size(*level_size(width, height, index))
        if len(levels[-1]) != length or inflated != expected or (head.scheme == NONE and length != expected):
            raise InputError(f"{name} lacks bytes of level {index}: it is not complete, or its index is wrong")
    values = _read_values(data[values_at : values_at + values_length], name)
    return StoredTexture(made, width, height, tuple(levels), values, head.scheme == ZSTANDARD)


def _is(made: GpuFormat, vk_format: int, model: int, transfer: int, channel: int) -> bool:
    """Whether a file is of a format; those without a number of Vulkan's are told by their descriptor."""
    if vk_format or made.vulkan:
        return made.vulkan == vk_format
    return (made.model, made.srgb, made.samples[0].channel) == (model, transfer == _SRGB, channel & 15)


def _zstandard() -> ModuleType:
    """Python's own library since 3.14, and the same before."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


def _inflated(stored: bytes, size: int, name: str, index: int) -> bytes:
    """A level of `size` bytes, and no more of the stream than that: a short one can inflate to gigabytes."""
    library = _zstandard()
    try:
        told = library.get_frame_info(stored).decompressed_size
        if told not in (None, size):  # None: the stream does not tell
            raise InputError(f"level {index} of {name} has {told} bytes when inflated, expected {size}")
        inflated: bytes = library.ZstdDecompressor().decompress(stored, size + 1)
    except library.ZstdError as error:
        raise InputError(f"level {index} of {name} is not a Zstandard stream ({error})") from error
    if len(inflated) != size:
        found = f"more than {size}" if len(inflated) > size else str(len(inflated))
        raise InputError(f"level {index} of {name} has {found} bytes when inflated, expected {size}")
    return inflated


def _read_values(data: bytes, name: str) -> dict[str, bytes]:
    found, at = {}, 0
    while at + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        key, end, value = data[at + 4 : at + 4 + length].partition(b"\0")
        if not end or at + 4 + length > len(data):
            raise InputError(f"{name} has key-value data that ends within an entry")
        found[key.decode("utf-8", "replace")] = value
        at += 4 + length + -length % 4
    return found
