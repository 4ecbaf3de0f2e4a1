"""Textures of a glTF document that are averaged, level by level, as the KTX 2 files that a GLB holds."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake._version import __version__
from mipbake.fill import fill
from mipbake.io import ktx2
from mipbake.io.colour import SRGB, decode, unit_range
from mipbake.io.decode import upsample
from mipbake.io.gltf.document import Document
from mipbake.io.gltf.extracted import Extracted
from mipbake.io.gltf.plain import PlainTexture
from mipbake.io.gltf.slots import COLOUR
from mipbake.io.gltf.write import SIDE
from mipbake.io.gpu_files import KTX2, GpuFile
from mipbake.io.layout import COLOUR as COLOUR_ENCODING
from mipbake.io.layout import UNIT, FileChannel, FileLayout
from mipbake.io.map_files import Levels, MapFile, quantised_levels
from mipbake.io.publish import temporary_folder
from mipbake.opacity import keeping_coverage, premultiplied
from mipbake.output import GLB_TEXELS
from mipbake.pixel_filter import filtered_levels

Image = NDArray[np.float32]


def averaged_files(
    document: Document, plain: Sequence[PlainTexture], levels: int | None = None
) -> list[tuple[PlainTexture, bytes]]:
    """Gives each texture a KTX 2 file of box-filtered levels: level 0 is the image, resampled where its sides are not
    multiples of `SIDE`. Colours are averaged linearly, by opacity where they have one, and opacity that is tested
    against a cutoff keeps its coverage.

    Args:
        document: the document that the textures belong to.
        levels: how many of each; None for all.

    Raises:
        InputError: an image cannot be read any more.
    """
    container = GpuFile(KTX2, GLB_TEXELS[0])
    about = json.dumps({"method": "linear", "pixel_filter": "box", "version": __version__})

    def encode(given: tuple[PlainTexture, Image]) -> tuple[PlainTexture, bytes]:
        texture, pixels = given
        chain = averaged(texture, pixels)[:levels]
        kinds = [COLOUR_ENCODING if texture.holds == COLOUR else UNIT] * 3 + [UNIT] * (pixels.shape[-1] - 3)
        layout = FileLayout("plain", tuple(FileChannel("plain", i, kind, "") for i, kind in enumerate(kinds)), False)
        file = MapFile(container, layout, chain)
        return texture, ktx2.encoded(container.texture(layout, quantised_levels(file), about), supercompress=True)

    with temporary_folder() as folder, ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        images = _Images(document, folder)
        return list(pool.map(encode, ((texture, images.pixels_of(texture)) for texture in plain)))


class _Images:
    """The images of a document, decoded."""

    def __init__(self, document: Document, folder: Path) -> None:
        self._images = Extracted(document, folder)

    def pixels_of(self, texture: PlainTexture) -> Image:
        """(H, W, 3), or 4 with the alpha that is read, in [0, 1], linear, sides multiples of `SIDE`."""
        header, stored = self._images.header(texture.image), self._images.pixels(texture.image)
        several = header.channels - (header.alpha >= 0) >= 3
        colours = np.broadcast_to(stored[..., :3] if several else stored[..., :1], (*stored.shape[:2], 3))
        parts = [decode(colours, SRGB) if texture.holds == COLOUR else unit_range(colours)]
        if texture.alpha:
            parts.append(unit_range(stored[..., header.alpha : header.alpha + 1]))
        pixels = np.concatenate(parts, -1)
        height, width = (-(-side // SIDE) * SIDE for side in pixels.shape[:2])
        return np.ascontiguousarray(upsample(pixels, width, height, texture.wrap))


def averaged(texture: PlainTexture, pixels: Image) -> Levels:
    """The levels of a texture, (H_L, W_L, C), from its pixels."""
    if not texture.opacity:
        return list(filtered_levels(pixels, "box", texture.wrap))
    opacity = pixels[..., 3]
    colours = fill(np.ascontiguousarray(pixels[..., :3]), (opacity > 0).astype(np.float32), texture.wrap)
    plain = filtered_levels(colours, "box", texture.wrap)
    alphas = list(filtered_levels(np.ascontiguousarray(pixels[..., 3:]), "box", texture.wrap))
    if texture.cutoff is not None:
        alphas = keeping_coverage(alphas, texture.cutoff)
    seen = premultiplied(colours, opacity, plain, "box", texture.wrap)
    return [np.concatenate(both, -1) for both in zip(seen, alphas, strict=True)]
