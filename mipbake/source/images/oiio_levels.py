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
from mipbake.source.images.image_files import ABOUT, PNG_SIGNATURE, check_png, write_image
from mipbake.source.images.quantise import dequantised, quantised
from mipbake.source.images.read_back import Band, whole_levels
from mipbake.source.layout import FileLayout

if TYPE_CHECKING:
    import OpenImageIO

WRAP_MODES = {"wrap": "periodic", "clamp": "clamp"}
"""What renderers call addressing, in the attribute `wrapmodes`."""

TYPES = {"8": "uint8", "16": "uint16", "half": "half", "float": "float"}
"""What OpenImageIO calls texels, by the name that users give."""

_PNG_HEAD = 128
"""Bytes that hold the first chunks of a PNG file, among them the chunk of the colour space."""

_BAND = 1 << 20
"""Texels that are read at a time where a file is read in bands."""


class PlainTexels:
    """What containers share whose texels are plain numbers: integers or floating-point ones.

    Args:
        texels: a name in `mipbake.source.images.quantise.KINDS`.
    """

    name: str
    exact = True
    signature = b""

    def __init__(self, texels: str) -> None:
        self.texels = texels

    @property
    def finer(self) -> str | None:
        """See Container."""
        if self.texels == "float":
            return None
        own = {"8": "16", "half": "float"}.get(self.texels)
        return f"{self.name}:{own}" if own else "exr"

    @property
    def stored(self) -> str:
        """Type of the texels, as OpenImageIO calls it."""
        return TYPES[self.texels]

    def precision(self, layout: FileLayout) -> str:
        """See Container."""
        del layout
        return self.stored

    def files(self, layout: FileLayout, levels: int) -> list[str]:
        """See Container: one file for all levels."""
        del levels
        return [f"{layout.name}.{self.name}"]

    def quantise(self, values: NDArray[np.float64], layout: FileLayout) -> NDArray[np.generic]:
        """See Container."""
        return quantised(values, self.texels, f"the map {layout.name}")

    def dequantise(self, texels: NDArray[np.generic]) -> NDArray[np.floating]:
        """See Container."""
        return dequantised(texels)

    def bands(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> Iterator[Band]:
        """See Container: levels as a whole."""
        return whole_levels(self.read(folder, layout, sizes))

    def read(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """See Container."""
        raise NotImplementedError

    def info(self, path: Path) -> FileInfo:
        """See Container."""
        return image_info(path)


def specification(
    layout: FileLayout, level: NDArray[np.generic], stored: str, wrap: tuple[str, str]
) -> OpenImageIO.ImageSpec:
    """What all formats have in common, of one level."""
    import OpenImageIO

    height, width, channels = level.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, stored)
    spec.channelnames = layout.channel_names
    # The fourth channel is data like the others: colours must not be multiplied or divided by it.
    spec.alpha_channel = -1
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("wrapmodes", ",".join(WRAP_MODES[mode] for mode in wrap))
    # Otherwise the time of writing is stored, and no two bakes would be the same file.
    spec.attribute("DateTime", "1970:01:01 00:00:00")
    return spec


def write_png(path: Path, texels: NDArray[np.uint16]) -> None:
    """Writes (H, W, C) texels as a PNG file. OSError or OutputError when that fails."""
    import OpenImageIO

    height, width, channels = texels.shape
    write_image(path, [(OpenImageIO.ImageSpec(width, height, channels, "uint16"), texels)])


def reader(path: Path) -> OpenImageIO.ImageInput:
    """A reader of a file; InputError when it is not there or no image."""
    import OpenImageIO

    disk.check_file(path)
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = OpenImageIO.ImageInput.open(str(path), config)
    if source is None:
        raise InputError(f"cannot read {path}: {told_by(OpenImageIO.geterror)}")
    return source


def take(
    source: OpenImageIO.ImageInput,
    path: Path,
    index: int,
    size: tuple[int, int],
    names: tuple[str, ...] | None,
    stored: str,
    level: int = 0,
    rows: tuple[int, int] | None = None,
) -> NDArray[np.generic]:
    """One level, (height, width, C).

    Args:
        index: of the level, for sentences. level: of the file, that holds it.
        names: of the channels, in the order in which they are given; None takes them as they lie.
        stored: type of the texels.
        rows: first and last of those that are read of a file of tiles; None for all.

    Raises:
        InputError: it has another size or other channels, or cannot be read.
    """
    spec, (height, width) = source.spec(), size
    found = list(spec.channelnames)
    if (spec.height, spec.width) != size or (names is not None and set(found) != set(names)):
        expected = f" with {', '.join(names)}" if names else ""
        raise InputError(
            f"level {index} of {path} is {spec.width} x {spec.height} with channels {', '.join(found)}, "
            f"expected {width} x {height}{expected}: bake or convert it again"
        )
    if rows is None:
        pixels = source.read_image(0, level, 0, len(found), stored)
    else:
        pixels = source.read_tiles(0, level, 0, width, *rows, 0, 1, 0, len(found), stored)
    if pixels is None or source.has_error:
        raise InputError(f"cannot read level {index} of {path}: {told_by(source.geterror)}")
    texels: NDArray[np.generic] = np.asarray(pixels).reshape(-1, width, len(found))
    # OpenEXR sorts channels by name.
    return texels if names is None or names == tuple(found) else texels[..., [found.index(n) for n in names]]


def take_all(
    path: Path, sizes: Sequence[tuple[int, int]], names: tuple[str, ...] | None, channels: int, stored: str
) -> list[NDArray[np.generic]]:
    """Every level of a file that holds all of its own; see `take`.

    Args:
        sizes: (height, width) of every level. names: of the channels, None where the format forgets them.
        channels: their number. stored: type of the texels.

    Raises:
        InputError: there are more or fewer levels, or one is not as it should be.
    """
    return [band.texels for band in take_bands(path, sizes, names, channels, stored, 0)]


def take_bands(
    path: Path, sizes: Sequence[tuple[int, int]], names: tuple[str, ...] | None, channels: int, stored: str, tile: int
) -> Iterator[Band]:
    """As `take_all`, some rows of tiles at a time, of a file whose tiles have so many rows; 0: levels as a whole."""
    source = reader(path)
    try:
        for index, size in enumerate(_levels(source, path, sizes, channels)):
            height, width = size
            step = max(1, _BAND // (width * tile)) * tile if tile else height
            for start in range(0, height, step):
                end = min(height, start + step)
                rows = (start, end) if tile else None
                yield Band(index, slice(start, end), take(source, path, index, size, names, stored, index, rows))
    finally:
        source.close()


def _levels(
    source: OpenImageIO.ImageInput, path: Path, sizes: Sequence[tuple[int, int]], channels: int
) -> Iterator[tuple[int, int]]:
    """Sizes, each after the reader stands at its level; InputError for more or fewer levels, or other channels."""
    for index, size in enumerate(sizes):
        if not source.seek_subimage(0, index):
            raise InputError(f"{path} has {index} levels, expected {len(sizes)}: bake or convert it again")
        if source.spec().nchannels != channels:
            raise InputError(
                f"{path} has {source.spec().nchannels} channels, expected {channels}: bake or convert it again"
            )
        yield size
    if source.seek_subimage(0, len(sizes)):
        raise InputError(f"{path} has more levels than the {len(sizes)} expected: bake or convert it again")


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
