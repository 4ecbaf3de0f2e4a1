"""`png`: one 8-bit PNG file per map and level."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import InputError, OutputError, UsageError
from mipbake.io.layout import COLOUR, SIGNED, UNIT, MapLayout
from mipbake.io.messages import one_line

_SLACK = 0.5 / 255
"""How far beyond 0..1 a value may lie: clipping it costs no more than rounding does."""


class MipPng:
    """`<map>_mip00.png` upwards; colours sRGB-encoded.

    Args:
        numbered: whether file names have a level; `<map>.png` otherwise, for maps of one level.
    """

    name = "png"
    summary = "one 8-bit PNG file per map and level, colours sRGB-encoded"
    precision = "uint8"
    srgb = True
    encodings = frozenset({COLOUR, UNIT, SIGNED})

    def __init__(self, numbered: bool = True) -> None:
        self._numbered = numbered

    def files(self, layout: MapLayout, levels: int) -> list[str]:
        """See Container."""
        if not self._numbered:
            return [f"{layout.name}.png"][:levels]
        return [f"{layout.name}_mip{level:02}.png" for level in range(levels)]

    def quantise(self, values: NDArray[np.float64], layout: MapLayout) -> NDArray[np.generic]:
        """See Container."""
        outside = [v for v in (float(values.min()), float(values.max())) if not -_SLACK <= v <= 1 + _SLACK]
        if outside:
            raise UsageError(
                f"format png cannot hold the map {layout.name}: it has the value {outside[0]:g}, outside 0 to 1, "
                "use format exr"
            )
        return np.floor(np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)

    def dequantise(self, texels: NDArray[np.generic]) -> NDArray[np.floating]:
        """See Container."""
        return texels.astype(np.float64) / 255

    def write(
        self, folder: Path, layout: MapLayout, levels: Sequence[NDArray[np.generic]], wrap: tuple[str, str]
    ) -> None:
        """See Container."""
        import OpenImageIO

        del wrap  # PNG has no place for it; stack.json tells
        for name, level in zip(self.files(layout, len(levels)), levels, strict=True):
            path = folder / name
            height, width, channels = level.shape
            spec = OpenImageIO.ImageSpec(width, height, channels, "uint8")
            # Data maps get no gamma chunk at all: a viewer must not touch them.
            spec.attribute("oiio:ColorSpace", "sRGB" if layout.is_colour else "Raw")
            # A third of the default level's time for files 6 % larger (1024 x 1024 colours and normals).
            spec.attribute("png:compressionLevel", 4)
            out = OpenImageIO.ImageOutput.create(str(path))
            if out is None:
                raise OutputError(f"cannot write {path}: {one_line(OpenImageIO.geterror())}")
            if not (out.open(str(path), spec) and out.write_image(np.ascontiguousarray(level)) and out.close()):
                raise OutputError(f"cannot write {path}: {one_line(out.geterror())}")
            del out

    def read(self, folder: Path, layout: MapLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """See Container."""
        import OpenImageIO

        levels: list[NDArray[np.generic]] = []
        channels = len(layout.encodings)
        for name, (height, width) in zip(self.files(layout, len(sizes)), sizes, strict=True):
            path = folder / name
            source = OpenImageIO.ImageInput.open(str(path))
            if source is None:
                raise InputError(f"cannot read {path}: {one_line(OpenImageIO.geterror())}")
            try:
                spec = source.spec()
                if (spec.height, spec.width, spec.nchannels) != (height, width, channels):
                    raise InputError(
                        f"{path} is {spec.width} x {spec.height} with {spec.nchannels} channels, "
                        f"expected {width} x {height} with {channels}: bake or convert it again"
                    )
                pixels = source.read_image(0, 0, 0, channels, "uint8")
                if pixels is None or source.has_error:
                    raise InputError(f"cannot read {path}: {one_line(source.geterror())}")
            finally:
                source.close()
            levels.append(np.asarray(pixels, np.uint8).reshape(height, width, channels))
        return levels
