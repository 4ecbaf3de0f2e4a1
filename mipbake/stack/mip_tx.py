"""`tx`: one tiled, MIP-mapped TIFF for each map, as renderers with OpenImageIO's texture system read them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.source.images.image_files import write_image
from mipbake.source.images.oiio_levels import PlainTexels, specification, take_all
from mipbake.source.layout import ENCODINGS, LOG, FileLayout

if TYPE_CHECKING:
    import OpenImageIO

_TILE = 64


class MipTx(PlainTexels):
    """Tiles of 64 x 64, levels rounded down, ZIP-compressed.

    Args:
        texels: "half" or "float", with colours linear Rec.709; "8" or "16" bits, with colours sRGB-encoded.
    """

    name = "tx"
    summary = "one tiled, MIP-mapped TIFF for each map, as Arnold and other renderers read them"
    complete = False

    def __init__(self, texels: str = "half") -> None:
        super().__init__(texels)
        self.encodings = ENCODINGS if texels in ("half", "float") else ENCODINGS - {LOG}

    def srgb(self, layout: FileLayout) -> bool:
        """See Container."""
        return layout.is_colour and self.texels in ("8", "16")

    def write(
        self,
        folder: Path,
        layout: FileLayout,
        levels: Sequence[NDArray[np.generic]],
        wrap: tuple[str, str],
        about: str,
    ) -> None:
        """See Container."""
        path = folder / f"{layout.name}.tx"

        def described(level: NDArray[np.generic]) -> OpenImageIO.ImageSpec:
            spec = specification(layout, level, self.stored, wrap)
            spec.tile_width = spec.tile_height = _TILE
            spec.attribute("textureformat", "Plain Texture")
            spec.attribute("compression", "zip")
            if self.srgb(layout):
                spec.attribute("oiio:ColorSpace", "sRGB")  # a tag of Exif; TIFF has none for linear colours and data
            # TIFF has no place for attributes of one's own.
            spec.attribute("ImageDescription", about)
            spec.attribute("Software", "mipbake")
            if self.texels == "half":
                spec.attribute("tiff:half", 1)
            return spec

        # The library says that TIFF has no levels, and takes subimages for them where `textureformat` is set.
        write_image(path, ((described(level), level) for level in levels), "AppendSubimage")

    def read(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """See Container."""
        path = folder / f"{layout.name}.tx"
        return take_all(path, sizes, None, len(layout.channels), self.stored)
