"""Containers that OpenImageIO writes: `exr` and `tx`, one file for each map, and `png`, one for each of its levels."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from mipbake.source.images.blocks import Weigh
from mipbake.source.images.file_facts import FileInfo
from mipbake.source.images.image_files import ABOUT, write_image
from mipbake.source.images.oiio_levels import image_info, take_all, take_bands
from mipbake.source.images.quantise import quantised
from mipbake.source.layout import ENCODINGS, LOG, FileLayout
from mipbake.stack.container import Band, Container, Sizes, Texels

if TYPE_CHECKING:
    import OpenImageIO

_T = TypeVar("_T")

_TILE = 64

_ZIP = 2
"""Level of EXR's compression, from 1 to 9. The default of the library, 4, takes a tenth more time and saves 1 % of
bytes, and 1 costs up to 7 % of bytes: measured on 23 sets."""

_WRAP_MODES = {"wrap": "periodic", "clamp": "clamp"}
"""What renderers call addressing, in the attribute `wrapmodes`."""


class PlainTexels(Container):
    """Containers whose texels are plain numbers: integers or floating-point ones.

    Args:
        texels: a name in `mipbake.source.images.quantise.KINDS`.
    """

    append: str
    """How OpenImageIO calls the writing of another level into a file."""

    named = False
    """Whether a file knows names of channels."""

    def __init__(self, texels: str) -> None:
        self.texels = texels

    @abstractmethod
    def describe(self, spec: OpenImageIO.ImageSpec, layout: FileLayout, about: str) -> None:
        """Adds what this kind of file says of each level."""

    @property
    def finer(self) -> str | None:
        """See Container."""
        if self.texels == "float":
            return None
        own = {"8": "16", "half": "float"}.get(self.texels)
        return f"{self.name}:{own}" if own else "exr"

    def precision(self, layout: FileLayout | None = None) -> str:
        """See Container: as OpenImageIO calls it."""
        del layout
        return {"8": "uint8", "16": "uint16"}.get(self.texels, self.texels)

    def quantise(self, values: NDArray[np.float64], layout: FileLayout) -> NDArray[np.generic]:
        """See Container."""
        return quantised(values, self.texels, f"the map {layout.name}")

    def write(
        self, folder: Path, layout: FileLayout, levels: Texels, wrap: tuple[str, str], about: str, weigh: Weigh | None
    ) -> None:
        """See Container."""
        del weigh  # texels are rounded one by one
        for first, path, held in self._held(folder, layout, levels):
            told = "" if first else about
            described = ((self._described(layout, level, wrap, told), level) for level in held)
            write_image(path, described, self.append)

    def read(self, folder: Path, layout: FileLayout, sizes: Sizes) -> Texels:
        """See Container."""
        names, count = layout.channel_names if self.named else None, len(layout.channels)
        files = self._held(folder, layout, sizes)
        return [each for at, path, held in files for each in take_all(path, held, names, count, self.precision(), at)]

    def info(self, path: Path) -> FileInfo:
        """See Container."""
        return image_info(path)

    def _held(self, folder: Path, layout: FileLayout, levels: Sequence[_T]) -> Iterator[tuple[int, Path, Sequence[_T]]]:
        """Every file, its first level, and what of all levels it holds."""
        names = self.files(layout, len(levels))
        each = len(levels) // len(names)
        return ((i * each, folder / name, levels[i * each : (i + 1) * each]) for i, name in enumerate(names))

    def _described(
        self, layout: FileLayout, level: NDArray[np.generic], wrap: tuple[str, str], about: str
    ) -> OpenImageIO.ImageSpec:
        import OpenImageIO

        height, width, channels = level.shape
        spec = OpenImageIO.ImageSpec(width, height, channels, self.precision())
        spec.channelnames = layout.channel_names
        # The fourth channel is data like the others: colours must not be multiplied or divided by it.
        spec.alpha_channel = -1
        spec.attribute("oiio:UnassociatedAlpha", 1)
        spec.attribute("wrapmodes", ",".join(_WRAP_MODES[mode] for mode in wrap))
        # Otherwise the time of writing is stored, and no two bakes would be the same file.
        spec.attribute("DateTime", "1970:01:01 00:00:00")
        self.describe(spec, layout, about)
        return spec


def _mipmapped(spec: OpenImageIO.ImageSpec) -> None:
    spec.tile_width = spec.tile_height = _TILE
    # Without this attribute OpenImageIO stores level 0 only, and reports no error.
    spec.attribute("textureformat", "Plain Texture")


class MipExr(PlainTexels):
    """One file for all levels of a map, in tiles of 64 x 64, levels rounded down; colours are linear Rec.709.

    Args:
        texels: "half" or "float".
        mipmapped: whether files hold levels; plain images in lines otherwise, for maps of one level.
    """

    name = "exr"
    summary = "one MIP-mapped OpenEXR file for each map, with linear colours"
    complete = True
    append = "AppendMIPLevel"
    named = True

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

    def bands(self, folder: Path, layout: FileLayout, sizes: Sizes) -> Iterator[Band]:
        """See Container."""
        if not self._mipmapped:
            return super().bands(folder, layout, sizes)
        ((_, path, _),) = self._held(folder, layout, sizes)
        return take_bands(path, sizes, layout.channel_names, len(layout.channels), self.precision(), _TILE)


class MipTx(PlainTexels):
    """A tiled TIFF for all levels of a map, as renderers with OpenImageIO's texture system read it.

    Args:
        texels: "half" or "float", with colours linear Rec.709; "8" or "16" bits, with colours sRGB-encoded.
    """

    name = "tx"
    summary = "one tiled, MIP-mapped TIFF for each map, as Arnold and other renderers read them"
    append = "AppendSubimage"  # the library says that TIFF has no levels, and takes subimages for them in textures

    def __init__(self, texels: str = "half") -> None:
        super().__init__(texels)
        if texels in ("8", "16"):
            self.encodings = ENCODINGS - {LOG}

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
    append = ""

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

    def describe(self, spec: OpenImageIO.ImageSpec, layout: FileLayout, about: str) -> None:
        """Adds colour space, compression and, at level 0, provenance."""
        # Data maps get no gamma chunk at all: a viewer must not touch them.
        spec.attribute("oiio:ColorSpace", "sRGB" if layout.is_colour else "Raw")
        # A third of the default level's time for files 6 % larger (1024 x 1024 colours and normals).
        spec.attribute("png:compressionLevel", 4)
        if about:
            spec.attribute(ABOUT, about)
