"""`exr`: one MIP-mapped half-float OpenEXR file per map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import InputError, OutputError, UsageError
from mipbake.io.layout import COLOUR, LOG, SIGNED, UNIT, MapLayout
from mipbake.io.messages import one_line

_TILE = 64
_WRAP_MODES = {"wrap": "periodic", "clamp": "clamp"}


class MipExr:
    """Tiled, levels rounded down, ZIP-compressed; colours linear Rec.709.

    Args:
        mipmapped: whether files hold levels; plain images in lines otherwise, for maps of one level.
    """

    name = "exr"
    summary = "one MIP-mapped half-float OpenEXR file per map, colours linear"
    precision = "half"
    srgb = False
    encodings = frozenset({COLOUR, UNIT, SIGNED, LOG})

    def __init__(self, mipmapped: bool = True) -> None:
        self._mipmapped = mipmapped

    def files(self, layout: MapLayout, levels: int) -> list[str]:
        """See Container."""
        del levels
        return [f"{layout.name}.exr"]

    def quantise(self, values: NDArray[np.float64], layout: MapLayout) -> NDArray[np.generic]:
        """See Container."""
        largest = float(np.abs(values).max())
        if not largest <= float(np.finfo(np.float16).max):
            raise UsageError(
                f"the map {layout.name} holds the value {largest:g}, beyond what a half-float file stores (65504): "
                "scale the source map down"
            )
        return values.astype(np.float16)

    def dequantise(self, texels: NDArray[np.generic]) -> NDArray[np.floating]:
        """See Container."""
        return texels.astype(np.float32)

    def write(
        self, folder: Path, layout: MapLayout, levels: Sequence[NDArray[np.generic]], wrap: tuple[str, str]
    ) -> None:
        """See Container."""
        import OpenImageIO

        path = folder / f"{layout.name}.exr"
        out = OpenImageIO.ImageOutput.create(str(path))
        if out is None:
            raise OutputError(f"cannot write {path}: {one_line(OpenImageIO.geterror())}")
        for index, level in enumerate(levels):
            height, width, channels = level.shape
            spec = OpenImageIO.ImageSpec(width, height, channels, "half")
            spec.channelnames = layout.channel_names
            if self._mipmapped:
                spec.tile_width = spec.tile_height = _TILE
                # Without this attribute OpenImageIO stores level 0 only, and reports no error.
                spec.attribute("textureformat", "Plain Texture")
            spec.attribute("wrapmodes", ",".join(_WRAP_MODES[mode] for mode in wrap))
            spec.attribute("compression", "zip")
            # Otherwise the time of writing is stored, and no two bakes would be the same file.
            spec.attribute("DateTime", "1970:01:01 00:00:00")
            if layout.is_colour:
                spec.attribute("oiio:ColorSpace", "lin_rec709")
            mode = "AppendMIPLevel" if index else "Create"
            if not (out.open(str(path), spec, mode) and out.write_image(np.ascontiguousarray(level))):
                raise OutputError(f"cannot write level {index} of {path}: {one_line(out.geterror())}")
        if not out.close():
            raise OutputError(f"cannot write {path}: {one_line(out.geterror())}")
        # The file is complete only when the writer is gone.
        del out

    def read(self, folder: Path, layout: MapLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """See Container."""
        import OpenImageIO

        path = folder / f"{layout.name}.exr"
        source = OpenImageIO.ImageInput.open(str(path))
        if source is None:
            raise InputError(f"cannot read {path}: {one_line(OpenImageIO.geterror())}")
        try:
            levels: list[NDArray[np.generic]] = []
            for index, (height, width) in enumerate(sizes):
                if not source.seek_subimage(0, index):
                    raise InputError(f"{path} has {index} levels, expected {len(sizes)}: bake or convert it again")
                spec = source.spec()
                names = list(spec.channelnames)
                if (spec.height, spec.width) != (height, width) or set(names) != set(layout.channel_names):
                    raise InputError(
                        f"level {index} of {path} is {spec.width} x {spec.height} with channels {', '.join(names)}, "
                        f"expected {width} x {height} with {', '.join(layout.channel_names)}: bake or convert it again"
                    )
                pixels = source.read_image(0, index, 0, len(names), "half")
                if pixels is None or source.has_error:
                    raise InputError(f"cannot read level {index} of {path}: {one_line(source.geterror())}")
                pixels = np.asarray(pixels, np.float16).reshape(height, width, len(names))
                # OpenEXR sorts channels by name.
                levels.append(pixels[..., [names.index(name) for name in layout.channel_names]])
            if source.seek_subimage(0, len(sizes)):
                raise InputError(f"{path} has more levels than the {len(sizes)} expected: bake or convert it again")
            return levels
        finally:
            source.close()
