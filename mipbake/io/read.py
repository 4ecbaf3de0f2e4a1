"""Reading image files through OpenImageIO: headers, and pixels in the type that the file stores."""

from __future__ import annotations

import hashlib
import io
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mipbake import memory
from mipbake.errors import InputError
from mipbake.io import disk
from mipbake.io.colour_names import told_by_file
from mipbake.io.messages import told_by

if TYPE_CHECKING:
    import OpenImageIO

IMAGE_SUFFIXES = frozenset(
    f".{s}"
    for s in (
        *("png", "jpg", "jpeg", "tif", "tiff", "tga", "exr", "hdr", "bmp", "webp", "dds", "psd", "jp2", "jxl"),
        *("sgi", "ppm", "pgm", "pnm", "tx", "avif", "ktx2"),
    )
)

_NATIVE = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float16, "float": np.float32}
"""Types that texels keep, by the name that OpenImageIO has for them."""

AT_ONCE = 1 << 20
"""Texels that are read together. A guess."""


@dataclass(frozen=True)
class Header:
    """What a file says of its image: size in texels, number of channels, the index of alpha (-1: none), stored type,
    number of images, and the colour space of its colours where the container tells it.
    """

    path: Path
    width: int
    height: int
    channels: int
    alpha: int
    depth: str
    subimages: int
    colour_space: str | None = None

    @property
    def is_integer(self) -> bool:
        """Whether values are stored as integers that stand for [0, 1]."""
        return self.depth not in ("half", "float", "double")


def read_header(path: Path) -> Header:
    """The header of an image file; InputError when it is not an image or has no texels."""
    if _is_other(path):
        return _other_header(path, disk.read_bytes(path))
    return _header(path, _open(path))


@dataclass(frozen=True)
class Image:
    """A file's first image: pixels (H, W, C) of uint8, uint16, float16 or float32 with the colours as stored (alpha not
    multiplied into them), its header, and the file's SHA-256 in hexadecimal.
    """

    pixels: NDArray[np.generic]
    header: Header
    sha256: str


def read_image(path: Path) -> Image:
    """Every texel of the first image in a file.

    Raises:
        InputError: the file is not an image, is damaged or cut short, or holds NaN or infinity.
    """
    data = disk.read_bytes(path)
    if data.startswith(PNG_SIGNATURE):
        check_png(path, io.BytesIO(data))
    digest = hashlib.sha256(data).hexdigest()
    if _is_other(path):
        return _other_image(path, data, digest)
    del data
    image = _open(path)
    header = _header(path, image)
    stored = header.depth if header.depth in _NATIVE else "float"
    pixels = memory.empty((header.height, header.width, header.channels), _NATIVE[stored])
    for rows, texels in _bands(image, stored):
        if texels is None or image.has_error:
            reason = told_by(image.geterror)
            raise InputError(f"{path} is damaged or cut short ({reason}): export or download it again")
        pixels[rows] = texels.reshape(-1, *pixels.shape[1:])
    image.close()
    _check_finite(path, pixels)
    return Image(pixels, header, digest)


def _bands(image: OpenImageIO.ImageInput, stored: str) -> Iterator[tuple[slice, NDArray[np.generic] | None]]:
    """The texels of an image, of one type, some rows at a time; None for rows that cannot be read."""
    spec = image.spec()
    tall = spec.tile_height or 1
    step = max(1, AT_ONCE // (spec.width * tall)) * tall
    for start in range(0, spec.height, step):
        end = min(spec.height, start + step)
        lines = spec.y + start, spec.y + end
        if spec.tile_width:
            columns = spec.x, spec.x + spec.width
            texels = image.read_tiles(*columns, *lines, spec.z, spec.z + 1, 0, spec.nchannels, stored)
        else:
            texels = image.read_scanlines(*lines, spec.z, 0, spec.nchannels, stored)
        yield slice(start, end), texels


def _is_other(path: Path) -> bool:
    """Whether a file is of a kind that OpenImageIO does not read."""
    from mipbake.io.other_images import START, is_other

    with disk.opened(path) as file:
        return is_other(file.read(START))


def _other_header(path: Path, data: bytes) -> Header:
    from mipbake.io.other_images import outline

    found = outline(data, path)
    _check_size(path, found.width, found.height)
    return Header(path, found.width, found.height, found.channels, found.alpha, found.depth, 1, found.colour_space)


def _other_image(path: Path, data: bytes, digest: str) -> Image:
    from mipbake.io.other_images import pixels_of

    header, pixels = _other_header(path, data), pixels_of(data, path)
    _check_finite(path, pixels)
    return Image(pixels, header, digest)


def _open(path: Path) -> OpenImageIO.ImageInput:
    import OpenImageIO

    _check_name(path)
    with disk.opened(path) as file:
        start = file.read(24)
    if not start:
        raise InputError(f"{path} is empty (0 bytes): export or download it again")
    if start.startswith(PNG_SIGNATURE) and len(start) == 24:
        _check_size(path, int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big"))
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    image = OpenImageIO.ImageInput.open(str(path), config)
    if image is None:
        raise InputError(f"{path} is not a readable {path.suffix or 'image'} image ({told_by(OpenImageIO.geterror)})")
    return image


def _check_name(path: Path) -> None:
    """InputError for a name whose bytes are not UTF-8, which OpenImageIO cannot take."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        shown = os.fsencode(path).decode("utf-8", "backslashreplace")
        raise InputError(f"the file name {shown} is not UTF-8: rename the file or its folder") from None


def _header(path: Path, image: OpenImageIO.ImageInput) -> Header:
    spec = image.spec()
    _check_size(path, spec.width, spec.height)
    count, space = 1, None
    if path.suffix.lower() == ".exr":
        space = told_by_file(spec.getattribute("oiio:ColorSpace"), spec.getattribute("chromaticities"))
        while image.seek_subimage(count, 0):
            count += 1
        image.seek_subimage(0, 0)
    return Header(path, spec.width, spec.height, spec.nchannels, spec.alpha_channel, str(spec.format), count, space)


def _check_size(path: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InputError(f"{path} is {width} x {height} texels: expected at least 1 x 1; export it again")


PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def check_png(path: Path, file: BinaryIO) -> None:
    """InputError for a PNG whose chunks are damaged or cut short: libpng fills what is missing silently, or prints to
    the standard error itself.
    """
    size, at = file.seek(0, os.SEEK_END), len(PNG_SIGNATURE)
    while at + 12 <= size:
        file.seek(at)
        length = int.from_bytes(file.read(4), "big")
        if at + 12 + length > size:
            break
        chunk = file.read(4 + length)
        if zlib.crc32(chunk) != int.from_bytes(file.read(4), "big"):
            name = chunk[:4].decode("ascii", "replace")
            raise InputError(f"{path} is damaged (checksum of {name} at byte {at}): export or download it again")
        if chunk[:4] == b"IEND":
            return
        at += 12 + length
    raise InputError(f"{path} is cut short after {size} bytes: export or download it again")


def _check_finite(path: Path, pixels: NDArray[np.generic]) -> None:
    if pixels.dtype.kind != "f":
        return
    count, first = 0, (0, 0, 0)
    for rows in memory.some_rows(pixels):
        bad = ~np.isfinite(pixels[rows])
        if not bad.any():
            continue
        if not count:
            place = np.unravel_index(int(np.argmax(bad)), bad.shape)
            first = rows.start + int(place[0]), int(place[1]), int(place[2])
        count += int(np.count_nonzero(bad))
    if count:
        row, column, channel = first
        raise InputError(
            f"{path} holds {count} NaN or infinite value{'s' if count > 1 else ''}, the first at row {row}, "
            f"column {column}, channel {channel}: replace them before baking"
        )
