"""Writing and reading the levels of a file through OpenImageIO, with the library's silences made errors."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.messages import told_by
from mipbake.source.images.file_facts import FileInfo, told
from mipbake.source.images.image_files import ABOUT, PNG_SIGNATURE, check_png, opened_image, write_image

if TYPE_CHECKING:
    import OpenImageIO

_PNG_HEAD = 128
"""Bytes that hold the first chunks of a PNG file, among them the chunk of the colour space."""

_BAND = 1 << 20
"""Texels that are read at a time where a file is read in bands."""


def write_png(path: Path, texels: NDArray[np.uint16]) -> None:
    """Writes (H, W, C) texels as a PNG file. OSError or OutputError when that fails."""
    import OpenImageIO

    height, width, channels = texels.shape
    write_image(path, [(OpenImageIO.ImageSpec(width, height, channels, "uint16"), texels)])


def reader(path: Path) -> OpenImageIO.ImageInput:
    """A reader of a file; InputError when it is not there or no image."""
    import OpenImageIO

    disk.check_file(path)
    source = opened_image(path)
    if source is None:
        raise InputError(f"cannot read {path}: {told_by(OpenImageIO.geterror)}")
    return source


def take_all(
    path: Path, sizes: Sequence[tuple[int, int]], names: tuple[str, ...] | None, channels: int, stored: str, first: int
) -> list[NDArray[np.generic]]:
    """Every level of a file, as whole bands of `take_bands`. `first`: the number of its first level, for sentences."""
    return [texels for _, _, texels in take_bands(path, sizes, names, channels, stored, 0, first)]


def take_bands(
    path: Path,
    sizes: Sequence[tuple[int, int]],
    names: tuple[str, ...] | None,
    channels: int,
    stored: str,
    tile: int,
    first: int = 0,
) -> Iterator[tuple[int, slice, NDArray[np.generic]]]:
    """Every level of a file that holds all of its own, some rows at a time: the level, the rows, (rows, W, C) texels.
    InputError for more or fewer levels, and where one has another size or other channels, or cannot be read.

    Args:
        sizes: (height, width) of every level.
        names: of the channels, in the order in which they are given; None where the format forgets them.
        stored: type of the texels.
        tile: rows of the file's tiles, of which some are read at a time; 0: levels as a whole.
    """
    again = "bake or convert it again"
    source = reader(path)
    try:
        for index, size in enumerate(sizes):
            if not source.seek_subimage(0, index):
                raise InputError(f"{path} has {index} levels, expected {len(sizes)}: {again}")
            spec, (height, width), label = source.spec(), size, f"level {first + index} of {path}"
            found = tuple(spec.channelnames)
            if len(found) != channels:
                raise InputError(f"{path} has {len(found)} channels, expected {channels}: {again}")
            if (spec.height, spec.width) != size or (names is not None and set(found) != set(names)):
                expected = f" with {', '.join(names)}" if names else ""
                raise InputError(
                    f"{label} is {spec.width} x {spec.height} with channels {', '.join(found)}, expected {width} x "
                    f"{height}{expected}: {again}"
                )
            step = max(1, _BAND // (width * tile)) * tile if tile else height
            for start in range(0, height, step):
                end = min(height, start + step)
                if tile:
                    pixels = source.read_tiles(0, index, 0, width, start, end, 0, 1, 0, channels, stored)
                else:
                    pixels = source.read_image(0, index, 0, channels, stored)
                if pixels is None or source.has_error:
                    raise InputError(f"cannot read {label}: {told_by(source.geterror)}")
                texels: NDArray[np.generic] = np.asarray(pixels).reshape(-1, width, channels)
                if names not in (None, found):  # OpenEXR sorts channels by name
                    texels = texels[..., [found.index(name) for name in names or ()]]
                yield index, slice(start, end), texels
        if source.seek_subimage(0, len(sizes)):
            raise InputError(f"{path} has more levels than the {len(sizes)} expected: {again}")
    finally:
        source.close()


def image_info(path: Path) -> FileInfo:
    """What is in an image that OpenImageIO reads, whoever wrote it. InputError where it reads none."""
    start = disk.read_bytes(path) if path.suffix.lower() == ".png" else b""
    if start.startswith(PNG_SIGNATURE):
        check_png(path, io.BytesIO(start))
    source = reader(path)
    try:
        spec = source.spec()

        def said(name: str) -> str:
            value = spec.getattribute(name)
            return value if isinstance(value, str) else ""  # broken files have numbers in places of texts

        attributes = {name: said(name) for name in ("textureformat", "wrapmodes", "compression") if said(name)}
        about = told(said(ABOUT) or said("ImageDescription"))
        channels, kind = tuple(spec.channelnames), str(spec.format)
        # The library takes PNG files that say nothing for sRGB.
        silent = path.suffix.lower() == ".png" and b"sRGB" not in start[:_PNG_HEAD]
        space = "" if silent else said("oiio:ColorSpace")
        levels = [(spec.width, spec.height)]
        while source.seek_subimage(0, len(levels)):
            levels.append((source.spec().width, source.spec().height))
        name = source.format_name()
    finally:
        source.close()
    return FileInfo(path, name, kind, channels, tuple(levels), space, path.stat().st_size, about, attributes)
