"""Reading image files: headers, and pixels in the type that the file stores, where the file says that they belong."""

from __future__ import annotations

import hashlib
import io
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk, memory
from mipbake.base.errors import InputError
from mipbake.base.messages import listed, told_by
from mipbake.source.images.image import Header, Image, Place, arranged, in_gltf
from mipbake.source.images.image_files import PNG_SIGNATURE, check_png, opened_image

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
"""Texels that are read together."""


def read_header(path: Path, role: str = "", metadata: bool = True) -> Header:
    """The header of the image for a role; InputError when the file is not an image or has no texels.

    Args:
        role: that the image fills: a file of several layers may name one for it.
        metadata: whether what the file says of orientation, alpha and colours counts; in glTF it does not.
    """
    from mipbake.source.images.other_images import START, header_of, is_other

    with disk.opened(path) as file:
        start = file.read(START)
    if is_other(start):
        return _applied(header_of(disk.read_bytes(path), path), metadata)
    return _header(path, _open(path, start), role, metadata)


def read_image(path: Path, role: str | Place = "", metadata: bool = True) -> Image:
    """Every texel of an image; see `read_header`. Instead of a role, the place of the layer that a role took.
    InputError also where it is damaged or cut short, or holds NaN or infinity."""
    from mipbake.source.images.other_images import START, header_of, is_other, pixels_of

    data = disk.read_bytes(path)
    start, digest = data[:START], hashlib.sha256(data).hexdigest()
    if start.startswith(PNG_SIGNATURE):
        check_png(path, io.BytesIO(data))
    if is_other(start):
        header, pixels = _applied(header_of(data, path), metadata), pixels_of(data, path)
    else:
        del data
        image = _open(path, start)
        header = _header(path, image, role, metadata)
        pixels = _pixels(path, image, header)
    pixels = arranged(pixels, header.declared)
    _check_finite(path, pixels)
    return Image(pixels, header, digest)


def _pixels(path: Path, image: OpenImageIO.ImageInput, header: Header) -> NDArray[np.generic]:
    """(H, W, C) texels of an image as stored, in the channels that its header names."""
    stored = header.depth if header.depth in _NATIVE else "float"
    spec, channels = image.spec(), header.declared.channels or tuple(range(image.spec().nchannels))
    pixels = memory.empty((spec.height, spec.width, len(channels)), _NATIVE[stored])
    low, high = min(channels), max(channels) + 1
    order = [channel - low for channel in channels]
    ordered = order == list(range(high - low))
    tall = spec.tile_height or 1
    step = max(1, AT_ONCE // (spec.width * tall)) * tall
    for start in range(0, spec.height, step):
        end = min(spec.height, start + step)
        lines = spec.y + start, spec.y + end
        if spec.tile_width:
            columns = spec.x, spec.x + spec.width
            texels = image.read_tiles(*columns, *lines, spec.z, spec.z + 1, low, high, stored)
        else:
            texels = image.read_scanlines(*lines, spec.z, low, high, stored)
        if texels is None or image.has_error:
            reason = told_by(image.geterror)
            raise InputError(f"{path} is damaged or cut short ({reason}): export or download it again")
        some = texels.reshape(-1, spec.width, high - low)
        pixels[start:end] = some if ordered else some[..., order]
    image.close()
    return pixels


def _applied(header: Header, metadata: bool) -> Header:
    """A header of stored texels made that of the image, as the file says that they are turned and placed."""
    said = header.declared if metadata else in_gltf(header.declared)
    width, height = said.size(header.width, header.height)
    _check_size(header.path, width, height)
    return replace(header, width=width, height=height, declared=said)


def _open(path: Path, start: bytes) -> OpenImageIO.ImageInput:
    import OpenImageIO

    _check_name(path)
    if not start:
        raise InputError(f"{path} is empty (0 bytes): export or download it again")
    if start.startswith(PNG_SIGNATURE) and len(start) >= 24:
        _check_size(path, int.from_bytes(start[16:20], "big"), int.from_bytes(start[20:24], "big"))
    image = opened_image(path)
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


def _header(path: Path, image: OpenImageIO.ImageInput, role: str | Place, metadata: bool) -> Header:
    from mipbake.source.images.file_says import said_by, taken_layer

    kind = image.format_name()
    layer, others = taken_layer(path, image, role) if kind == "openexr" else (None, "")
    spec = image.spec()
    _check_size(path, spec.width, spec.height)
    said = said_by(path, image)
    notes, warnings = [*said.notes], [*said.warnings]
    channels, alpha, depth = spec.nchannels, spec.alpha_channel, str(spec.format)
    if layer:
        channels, alpha, depth = len(layer.channels), layer.alpha, layer.depth
        said = replace(said, channels=layer.channels, part=layer.part, layer=layer.name)
        if others:
            notes.append(f"its layer {layer.name or 'without a name'} is taken, and not {others}")
    elif said.channels:
        channels, alpha = len(said.channels), said.channels.index(alpha) if alpha in said.channels else -1
    elif kind == "tiff":
        count = 1
        while image.seek_subimage(count, 0):
            count += 1
        told_by(image.geterror)  # clears it: the reader calls the end of the images an error
        image.seek_subimage(0, 0)
        if count > 1:
            warnings.append(f"it holds {count} images: only the first is read")
    unknown = [name for index, name in enumerate(spec.channelnames) if index > 2 and index != alpha]
    if layer is None and channels > 3 and unknown:
        notes.append(f"the file does not say what is in its channels {listed(unknown)}: they are left out")
    said = replace(said, notes=tuple(notes), warnings=tuple(warnings))
    return _applied(Header(path, spec.width, spec.height, channels, alpha, depth, said), metadata)


def _check_size(path: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise InputError(f"{path} is {width} x {height} texels: expected at least 1 x 1; export it again")


def _check_finite(path: Path, pixels: NDArray[np.generic]) -> None:
    if pixels.dtype.kind != "f":
        return
    count, first = 0, np.zeros(3, np.intp)
    for rows in memory.some_rows(pixels):
        bad = np.argwhere(~np.isfinite(pixels[rows]))
        if len(bad) and not count:
            first = bad[0] + (rows.start, 0, 0)
        count += len(bad)
    if count:
        row, column, channel = first
        raise InputError(
            f"{path} holds {count} NaN or infinite value{'s' if count > 1 else ''}, the first at row {row}, "
            f"column {column}, channel {channel}: replace them before baking"
        )
