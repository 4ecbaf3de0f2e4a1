"""`png`: one PNG file per map and level."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.source.images.image_files import ABOUT, write_image
from mipbake.source.images.oiio_levels import PlainTexels, reader, specification, take
from mipbake.source.layout import ENCODINGS, LOG, FileLayout


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
    ) -> None:
        """See Container."""
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
