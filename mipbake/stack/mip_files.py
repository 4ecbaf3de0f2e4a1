"""Containers that OpenImageIO writes: `exr` and `tx`, one file for each map, and `png`, one for each of its levels."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.source.images.blocks import Weigh
from mipbake.source.images.image_files import ABOUT, write_image
from mipbake.source.images.oiio_levels import PlainTexels, reader, specification, take, take_all, take_bands
from mipbake.source.images.read_back import Band
from mipbake.source.layout import ENCODINGS, LOG, FileLayout

if TYPE_CHECKING:
    import OpenImageIO

_TILE = 64

_ZIP = 2
"""Level of EXR's compression, from 1 to 9. The default of the library, 4, takes a tenth more time and saves 1 % of
bytes, and 1 costs up to 7 % of bytes: measured on 23 sets."""


class _AllLevels(PlainTexels):
    """One file for all levels of a map, in tiles of 64 x 64, levels rounded down, ZIP-compressed."""

    append: str
    """How OpenImageIO calls the writing of another level."""

    named = True
    """Whether the file knows names of channels."""

    @abstractmethod
    def describe(self, spec: OpenImageIO.ImageSpec, layout: FileLayout, about: str) -> None:
        """Adds what this kind of file says of each level."""

    def write(
        self,
        folder: Path,
        layout: FileLayout,
        levels: Sequence[NDArray[np.generic]],
        wrap: tuple[str, str],
        about: str,
        weigh: Weigh | None = None,
    ) -> None:
        """See Container."""
        del weigh  # texels are rounded one by one

        def described(level: NDArray[np.generic]) -> OpenImageIO.ImageSpec:
            spec = specification(layout, level, self.stored, wrap)
            self.describe(spec, layout, about)
            return spec

        write_image(self._path(folder, layout), ((described(level), level) for level in levels), self.append)

    def read(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """See Container."""
        names = layout.channel_names if self.named else None
        return take_all(self._path(folder, layout), sizes, names, len(layout.channels), self.stored)

    def _path(self, folder: Path, layout: FileLayout) -> Path:
        return folder / self.files(layout, 1)[0]


def _mipmapped(spec: OpenImageIO.ImageSpec) -> None:
    spec.tile_width = spec.tile_height = _TILE
    # Without this attribute OpenImageIO stores level 0 only, and reports no error.
    spec.attribute("textureformat", "Plain Texture")


class MipExr(_AllLevels):
    """Colours are linear Rec.709.

    Args:
        texels: "half" or "float".
        mipmapped: whether files hold levels; plain images in lines otherwise, for maps of one level.
    """

    name = "exr"
    summary = "one MIP-mapped OpenEXR file for each map, with linear colours"
    encodings = ENCODINGS
    complete = True
    append = "AppendMIPLevel"

    def __init__(self, texels: str = "half", mipmapped: bool = True) -> None:
        super().__init__(texels)
        self._mipmapped = mipmapped

    def srgb(self, layout: FileLayout) -> bool:
        """See Container."""
        del layout
        return False

    def describe(self, spec: OpenImageIO.ImageSpec, layout: FileLayout, about: str) -> None:
        """Adds compression, provenance and colour space."""
        if self._mipmapped:
            _mipmapped(spec)
        spec.attribute("compression", f"zip:{_ZIP}")
        spec.attribute(ABOUT, about)
        if layout.is_colour:
            spec.attribute("oiio:ColorSpace", "lin_rec709")

    def bands(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> Iterator[Band]:
        """See Container."""
        if not self._mipmapped:
            return super().bands(folder, layout, sizes)
        path, names = self._path(folder, layout), layout.channel_names
        return take_bands(path, sizes, names, len(layout.channels), self.stored, _TILE)


class MipTx(_AllLevels):
    """A TIFF, as renderers with OpenImageIO's texture system read it.

    Args:
        texels: "half" or "float", with colours linear Rec.709; "8" or "16" bits, with colours sRGB-encoded.
    """

    name = "tx"
    summary = "one tiled, MIP-mapped TIFF for each map, as Arnold and other renderers read them"
    complete = False
    append = "AppendSubimage"  # the library says that TIFF has no levels, and takes subimages for them in textures
    named = False

    def __init__(self, texels: str = "half") -> None:
        super().__init__(texels)
        self.encodings = ENCODINGS if texels in ("half", "float") else ENCODINGS - {LOG}

    def srgb(self, layout: FileLayout) -> bool:
        """See Container."""
        return layout.is_colour and self.texels in ("8", "16")

    def describe(self, spec: OpenImageIO.ImageSpec, layout: FileLayout, about: str) -> None:
        """Adds compression, colour space and provenance."""
        _mipmapped(spec)
        spec.attribute("compression", "zip")
        if self.srgb(layout):
            spec.attribute("oiio:ColorSpace", "sRGB")  # a tag of Exif; TIFF has none for linear colours and data
        # TIFF has no place for attributes of one's own.
        spec.attribute("ImageDescription", about)
        spec.attribute("Software", "mipbake")
        if self.texels == "half":
            spec.attribute("tiff:half", 1)


class MipPng(PlainTexels):
    """`<map>_mip00.png` upwards; colours sRGB-encoded.

    Args:
        texels: "8" or "16" bits.
        numbered: whether file names have a level; `<map>.png` otherwise, for maps of one level.
    """

    name = "png"
    summary = "one PNG file for each level of each map, with sRGB-encoded colours"
    encodings = ENCODINGS - {LOG}
    complete = False

    def __init__(self, texels: str = "8", numbered: bool = True) -> None:
        super().__init__(texels)
        self._numbered = numbered

    def srgb(self, layout: FileLayout) -> bool:
        """See Container."""
        return layout.is_colour

    def files(self, layout: FileLayout, levels: int) -> list[str]:
        """See Container."""
        if not self._numbered:
            return [f"{layout.name}.png"][:levels]
        return [f"{layout.name}_mip{level:02}.png" for level in range(levels)]

    def write(
        self,
        folder: Path,
        layout: FileLayout,
        levels: Sequence[NDArray[np.generic]],
        wrap: tuple[str, str],
        about: str,
        weigh: Weigh | None = None,
    ) -> None:
        """See Container."""
        del weigh  # texels are rounded one by one
        for index, (name, level) in enumerate(zip(self.files(layout, len(levels)), levels, strict=True)):
            spec = specification(layout, level, self.stored, wrap)
            # Data maps get no gamma chunk at all: a viewer must not touch them.
            spec.attribute("oiio:ColorSpace", "sRGB" if layout.is_colour else "Raw")
            # A third of the default level's time for files 6 % larger (1024 x 1024 colours and normals).
            spec.attribute("png:compressionLevel", 4)
            if index == 0:
                spec.attribute(ABOUT, about)
            write_image(folder / name, [(spec, level)])

    def read(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """See Container."""
        levels = []
        for index, (name, size) in enumerate(zip(self.files(layout, len(sizes)), sizes, strict=True)):
            path = folder / name
            source = reader(path)
            try:
                if source.spec().nchannels != len(layout.channels):
                    raise InputError(
                        f"{path} has {source.spec().nchannels} channels, expected {len(layout.channels)}: "
                        "bake or convert it again"
                    )
                levels.append(take(source, path, index, size, None, self.stored))
            finally:
                source.close()
        return levels
