"""KTX 2.0 files: header, data format descriptor, key-value data and levels, written and read.

The structure follows the KTX File Format Specification 2.0; descriptors follow the Khronos Data Format Specification
1.3. Levels come as the bytes that a GPU takes; the encoders turn texels into these bytes.
"""

from __future__ import annotations

import math
import struct
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import ModuleType

from mipbake.base.errors import InputError
from mipbake.source.images.gpu_format import READ_FORMATS, GpuFormat, GpuTexture, level_size

IDENTIFIER = bytes.fromhex("AB4B5458203230BB0D0A1A0A")
_HEADER = struct.Struct("<9I")  # vkFormat to supercompressionScheme
_INDEX = struct.Struct("<4I2Q")  # offset and length of descriptor, key-value data, supercompression global data
_LEVEL = struct.Struct("<3Q")  # offset, length, length when inflated
_START = len(IDENTIFIER) + _HEADER.size + _INDEX.size

NONE, BASIS_LZ, ZSTANDARD, ZLIB = range(4)
"""supercompressionScheme of levels in the specification: as they are, one for ETC1S alone, or a stream for each."""

_READ_SCHEMES = (NONE, ZSTANDARD, ZLIB)

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
    unit = 2 if made.is_float else 1  # bytes in which endianness matters
    header = _HEADER.pack(made.vulkan, unit, texture.width, texture.height, 0, 0, 1, len(levels), scheme)
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
        struct.pack("<HBB4B2I", first, bits - 1, channel, 0, 0, 0, 0, low, high)
        for first, bits, channel, low, high in made.samples
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
    """What the header of a file says, whatever its texels are.

    Args:
        texels: what they are stored as, in the name that users know.
        format: the format of texels that are decoded here; None for others.
        levels: (width, height) of each, finest first; of level 0 alone where who loads the file is to make the others.
        count: of levels that the file holds; 0: one, see above.
        scheme: supercompressionScheme of the levels.
        transfer, primaries: of the descriptor, as numbers of the data format specification; 0 is unspecified.
        premultiplied: whether the descriptor says that colours are multiplied by alpha.
        channels: of the descriptor's samples.
        several: what makes it more than one image of two dimensions, and how to get one; empty where it is one.
        values: key-value data.
    """

    texels: str
    format: GpuFormat | None
    levels: tuple[tuple[int, int], ...]
    count: int
    scheme: int
    transfer: int
    primaries: int
    premultiplied: bool
    channels: tuple[int, ...]
    several: str
    values: Mapping[str, bytes]

    @property
    def srgb(self) -> bool:
        """Whether colours are sRGB-encoded."""
        return self.transfer == _SRGB

    @property
    def readable(self) -> bool:
        """Whether `decoded` reads files of this kind."""
        return self.format is not None and not self.several and self.scheme in _READ_SCHEMES


ETC1S = "ETC1S"
_MODELS = {
    **{128: "BC1", 129: "BC2", 130: "BC3", 131: "BC4", 132: "BC5", 133: "BC6H", 134: "BC7"},
    **{160: "ETC1", 161: "ETC2", 162: "ASTC", 163: ETC1S, 164: "PVRTC", 165: "PVRTC2", 166: "UASTC"},
    **{167: "UASTC HDR 4x4", 168: "UASTC HDR 6x6"},
}
"""Colour models in the data format specification."""

_PREMULTIPLIED = 1  # flag of the descriptor
_MOST_SAMPLES = 16  # of the descriptor; formats that are known here have four at most


def outline(data: bytes, name: str) -> Outline:
    """What the header of a file says; InputError, which calls it `name`, where it is not a KTX 2 file or is broken."""
    if data[: len(IDENTIFIER)] != IDENTIFIER:
        raise InputError(f"{name} is not a KTX 2 file: it does not begin like one")
    try:
        vulkan, _, width, height, depth, layers, faces, count, scheme = _HEADER.unpack_from(data, len(IDENTIFIER))
        descriptor_at, _, values_at, values_length, *_ = _INDEX.unpack_from(data, len(IDENTIFIER) + _HEADER.size)
        size, model, primaries, transfer, flags = struct.unpack_from("<H4B", data, descriptor_at + 10)
        samples = min(_MOST_SAMPLES, max(1, (size - 24) // 16))
        channels = tuple(struct.unpack_from("<B", data, descriptor_at + 31 + 16 * i)[0] & 15 for i in range(samples))
    except struct.error as error:
        raise InputError(f"{name} ends within its header: it is not a complete KTX 2 file") from error
    if not width or not height:
        raise InputError(f"{name} is {width} x {height} texels: expected a texture of two dimensions")
    if max(width, height) > MOST:
        raise InputError(f"{name} declares {width} x {height} texels: expected {MOST} along a side at most")
    most = max(width, height).bit_length()
    if count > most:
        raise InputError(f"{name} declares {count} levels: {width} x {height} texels have 1 to {most}")
    made = next((f for f in READ_FORMATS.values() if _is(f, vulkan, model, transfer, channels[0])), None)
    number = f"Vulkan format {vulkan}" if vulkan else ""
    texels = _MODELS.get(model, "" if vulkan else f"colour model {model}")
    return Outline(
        made.name if made else f"{texels} ({number})" if texels and number else texels or number,
        made,
        tuple(level_size(width, height, index) for index in range(max(1, count))),
        count,
        scheme,
        transfer,
        primaries,
        bool(flags & _PREMULTIPLIED),
        channels,
        _several(depth, layers, faces),
        _read_values(data[values_at : values_at + values_length], name),
    )


def _several(depth: int, layers: int, faces: int) -> str:
    """What is more than one image; one layer, or one slice, is an image."""
    if faces != 1:
        what, part, option = f"a cube map of {faces} faces", "face", "--face"
    elif layers > 1:
        what, part, option = f"an array of {layers} layers", "layer", "--layer"
    elif depth > 1:
        what, part, option = f"a 3D texture of {depth} slices", "slice", "--depth"
    else:
        return ""
    return f"{what}: extract one {part} as an image of its own (ktx extract {option} 0)"


def stored(data: bytes, name: str) -> tuple[bytes, ...]:
    """The levels of a file, nothing inflated; InputError as for `decoded`, except for streams that are broken."""
    found = outline(data, name)
    if found.several:
        raise InputError(f"{name} holds {found.several}")
    if found.format is None:
        raise InputError(
            f"{name} has texels of {found.texels}, which are not decoded here: expected plain ones of 8 bits or half "
            "floats, BC1 to BC5, BC7, UASTC or ETC1S; export it as PNG or EXR (ktx extract)"
        )
    if not found.count:
        width, height = found.levels[0]
        most = max(width, height).bit_length()
        raise InputError(f"{name} declares 0 levels: {width} x {height} texels have 1 to {most}")
    if found.scheme not in _READ_SCHEMES:
        scheme = "BasisLZ" if found.scheme == BASIS_LZ else str(found.scheme)
        raise InputError(
            f"{name} has the supercompression scheme {scheme}: expected none, Zstandard or zlib; pack it again"
        )
    levels = []
    for index, size in enumerate(found.levels):
        try:
            at, length, inflated = _LEVEL.unpack_from(data, _START + _LEVEL.size * index)
        except struct.error as error:
            raise InputError(f"{name} ends within its header: it is not a complete KTX 2 file") from error
        levels.append(data[at : at + length])
        expected = found.format.level_size(*size)
        if len(levels[-1]) != length or inflated != expected or (found.scheme == NONE and length != expected):
            raise InputError(f"{name} lacks bytes of level {index}: it is not complete, or its index is wrong")
    return tuple(levels)


def decoded(data: bytes, name: str) -> GpuTexture:
    """The texture of a file; InputError, which calls it `name`, where it is broken or of a kind that is not read."""
    levels, found = stored(data, name), outline(data, name)
    assert found.format is not None
    if found.scheme != NONE:
        sizes = (found.format.level_size(*size) for size in found.levels)
        levels = tuple(
            _inflated(level, found.scheme, size, f"level {index} of {name}")
            for index, (level, size) in enumerate(zip(levels, sizes, strict=True))
        )
    return GpuTexture(found.format, *found.levels[0], levels, found.values)


def _is(made: GpuFormat, vk_format: int, model: int, transfer: int, channel: int) -> bool:
    """Whether a file is of a format; those without a number of Vulkan's are told by their descriptor."""
    if vk_format or made.vulkan:
        return made.vulkan == vk_format
    return (made.model, made.srgb, made.held[0]) == (model, transfer == _SRGB, channel)


def _zstandard() -> ModuleType:
    """Python's own library since 3.14, and the same before."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


def _inflated(stored: bytes, scheme: int, size: int, what: str) -> bytes:
    """A level of `size` bytes, and no more of the stream than that: a short one can inflate to gigabytes."""
    library = _zstandard()
    try:
        if scheme == ZLIB:
            inflated = zlib.decompressobj().decompress(stored, size + 1)
        else:
            declared = library.get_frame_info(stored).decompressed_size
            if declared not in (None, size):  # None: the stream does not say
                raise InputError(f"{what} has {declared} bytes when inflated, expected {size}")
            inflated = library.ZstdDecompressor().decompress(stored, size + 1)
    except (zlib.error, library.ZstdError) as error:
        name = "zlib" if scheme == ZLIB else "Zstandard"
        raise InputError(f"{what} is not a {name} stream ({error})") from error
    if len(inflated) != size:
        found = f"more than {size}" if len(inflated) > size else str(len(inflated))
        raise InputError(f"{what} has {found} bytes when inflated, expected {size}")
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
