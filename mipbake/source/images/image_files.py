"""Images that OpenImageIO writes, and what shows that all of a file is there.

The library writes the last part of a file as it closes it, and loses the failures of that. Readers repair some of the
damage silently: they rebuild a table of offsets, or take a missing text for an empty one. So texels that read back do
not show that a file is whole. Everything that a library writes is looked through here before anybody relies on it.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk
from mipbake.base.errors import InputError, OutputError
from mipbake.base.messages import told_by
from mipbake.base.publish import check_room

if TYPE_CHECKING:
    import OpenImageIO

ABOUT = "mipbake"
"""Attribute, key or chunk that holds how a file was made, as JSON."""

_TEXTS = (ABOUT, "ImageDescription", "Software", "textureformat", "wrapmodes")
"""Attributes that a file of EXR or TIFF gives back as they were given."""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EXR_SIGNATURE, _MULTI_PART, _TILED = b"\x76\x2f\x31\x01", 0x1000, 0x200
_TIFF_SIGNATURES = (b"II*\0", b"II+\0")
_TIFF_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 13: 4, 16: 8, 18: 8}
"""Bytes of a value, by the number of its type."""

_MOST_TAGS = 1 << 16

_OF_A_LEVEL = {254, 256, 257, 324, 325, 34665}
"""Tags that differ from level to level: the kind, the size and the tiles of a level, and Exif, which level 0 has."""


def opened_image(path: Path) -> OpenImageIO.ImageInput | None:
    """A reader of an image that gives colours as they are stored, not multiplied by alpha; None where it is no image,
    as `OpenImageIO.geterror` then says."""
    import OpenImageIO

    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    return OpenImageIO.ImageInput.open(str(path), config)


def write_image(
    path: Path, levels: Iterable[tuple[OpenImageIO.ImageSpec, NDArray[np.generic]]], following: str = ""
) -> None:
    """Writes an image, and looks whether all of the file is there; texels are for the caller to compare. OSError or
    OutputError, whichever says more, where it cannot be written.

    Args:
        levels: the description and the (H, W, C) texels of each level, in the order in which they are stored.
        following: how OpenImageIO adds levels to the first one: "AppendMIPLevel" or "AppendSubimage".
    """
    import OpenImageIO

    out = OpenImageIO.ImageOutput.create(str(path))
    if out is None:
        raise OutputError(f"cannot write {path}: {told_by(OpenImageIO.geterror)}")
    specs: list[OpenImageIO.ImageSpec] = []
    size = 0
    for spec, level in levels:
        # All texels go in one call. OpenImageIO's write_image goes on after a row of tiles that could not be written,
        # and OpenEXR then waits for ever for memory that the failure has kept.
        texels = np.ascontiguousarray(level)
        written = out.open(str(path), spec, following if specs else "Create")
        if written and spec.tile_width:
            written = out.write_tiles(0, spec.width, 0, spec.height, 0, 1, texels)
        elif written:
            written = out.write_scanlines(0, spec.height, 0, texels)
        if not written:
            check_room(path, level.nbytes)
            raise OutputError(f"cannot write level {len(specs)} of {path}: {told_by(out.geterror)}")
        specs.append(spec)
        size += level.nbytes
    closed = out.close()
    why = "" if closed else told_by(out.geterror)
    del out  # the file is complete only when nothing holds the writer any more
    if not why:
        why = _fault(path, specs[0])
    if why:
        check_room(path, size)
        raise OutputError(f"{path} is not complete after writing ({why}): check the disk")


def _fault(path: Path, first: OpenImageIO.ImageSpec) -> str:
    """What of a file is missing, its texels apart; "" for nothing. `first`: the description of level 0, whose
    attributes the file has to give back."""
    import OpenImageIO

    try:
        with disk.opened(path) as file:
            if file.read(len(PNG_SIGNATURE)) == PNG_SIGNATURE:
                check_png(path, file)
                return ""
        check_exr(path)
        _check_tiff(path)
    except InputError as error:
        return str(error)
    source = opened_image(path)
    if source is None:
        return told_by(OpenImageIO.geterror)
    found = source.spec()
    source.close()
    lost = [name for name in _TEXTS if first.getattribute(name) not in (None, found.getattribute(name))]
    return f"the attribute {lost[0]} is missing" if lost else ""


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


def _check_tiff(path: Path) -> None:
    """InputError for a TIFF file whose levels have not all the same tags, each within the file and with the same value
    where all levels have one; nothing for a file that is none.
    """
    with disk.opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(4) not in _TIFF_SIGNATURES:
            return
        first: dict[int, bytes] | None = None
        for index, found in enumerate(tiff_directories(file, size)):
            cut = [tag for tag, (length, value) in found.items() if not length or len(value) < length]
            if cut:
                raise InputError(f"its tag {cut[0]} of level {index} is cut short")
            tags = {tag: value for tag, (_, value) in found.items() if tag not in _OF_A_LEVEL}
            first = tags if first is None else first
            if tags != first or index > size:
                raise InputError(f"its level {index} has other tags than level 0")


def tiff_directories(file: BinaryIO, most: int) -> Iterator[dict[int, tuple[int, bytes]]]:
    """The tags of each image of a TIFF file, which may be a large one ("BigTIFF"): number to the length of its value,
    and to the bytes of it, `most` at most, and fewer where the file ends before."""
    file.seek(0)
    head = file.read(4)
    order: Literal["little", "big"] = "little" if head[:2] == b"II" else "big"
    wide = int.from_bytes(head[2:], order) == 43
    word = 8 if wide else 4

    def number(size: int) -> int:
        return int.from_bytes(file.read(size), order)

    file.seek(word)
    while at := number(word):
        file.seek(at)
        tags: dict[int, tuple[int, bytes]] = {}
        for _ in range(min(number(8 if wide else 2), _MOST_TAGS)):
            tag, kind, count = number(2), number(2), number(word)
            here, length = file.tell(), count * _TIFF_SIZES.get(kind, 0)
            if length > word:
                file.seek(number(word))
            tags[tag] = length, file.read(min(length, most))
            file.seek(here + word)
        yield tags


def check_exr(path: Path) -> None:
    """InputError for an OpenEXR file whose table of offsets does not lead to its chunks, each to another one, without
    gaps up to the end of the file; nothing for a file that is none.
    """
    with disk.opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(len(_EXR_SIGNATURE)) != _EXR_SIGNATURE:
            return
        flags = _number(file)
        while _skip_header(file) and flags & _MULTI_PART:
            pass
        start = file.tell()
        first = _number(file, 8)
        if not start < first <= size:
            raise InputError("it has no table of offsets")
        file.seek(start)
        at = first
        for offset in sorted(np.frombuffer(file.read(first - start), "<u8").tolist()):
            if offset != at:
                raise InputError(f"its table of offsets does not lead to byte {at}")
            file.seek(at + (4 if flags & _MULTI_PART else 0) + (16 if flags & _TILED else 4))
            at = _number(file) + file.tell()
        if at != size:
            raise InputError(f"its chunks end at byte {at} of {size}")


def _skip_header(file: BinaryIO) -> bool:
    """Goes to the end of a header; whether there was anything in it, as in all but the last one of several."""
    found = False
    while _skip_word(file):  # the name of an attribute, then that of its type
        found = True
        _skip_word(file)
        file.seek(_number(file), os.SEEK_CUR)
    return found


def _skip_word(file: BinaryIO) -> bool:
    count = 0
    while file.read(1) not in (b"", b"\0"):
        count += 1
    return count > 0


def _number(file: BinaryIO, size: int = 4) -> int:
    return int.from_bytes(file.read(size), "little")
