"""Textures of a glTF document that are averaged, level by level, as the KTX 2 files that a GLB holds."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.base.publish import temporary_folder
from mipbake.base.version import __version__
from mipbake.material.fill import fill
from mipbake.material.pixel_filter import filtered_levels
from mipbake.source.gltf.document import Document
from mipbake.source.gltf.images import Images
from mipbake.source.gltf.plain import PlainTexture, shown_by
from mipbake.source.gltf.slots import COLOUR
from mipbake.source.images import ktx2
from mipbake.source.images.blocks import from_blocks
from mipbake.source.images.gpu_format import GpuTexture
from mipbake.source.layout import COLOUR as COLOUR_ENCODING
from mipbake.source.layout import UNIT, FileChannel, FileLayout
from mipbake.source.opacity import keeping_coverage, premultiplied
from mipbake.stack.gpu_files import Ktx2File
from mipbake.stack.map_files import Levels, MapFile, quantised_levels
from mipbake.stack.output import GLB_TEXELS

Image = NDArray[np.float32]

LEAST_PSNR = 40.0
"""dB of level 0, below which blocks visibly change a texture, which then stays as it is."""


@dataclass(frozen=True)
class PlainCost:
    """What blocks cost an averaged texture.

    Args:
        shown: what shows it.
        psnr: peak signal-to-noise ratio of level 0, in dB, of stored values between 0 and 1; infinite where nothing
            changed.
    """

    shown: str
    psnr: float

    @property
    def stays(self) -> bool:
        """Whether the document keeps the image as it is, because blocks cost it too much."""
        return self.psnr < LEAST_PSNR

    def __str__(self) -> str:
        if self.stays:
            return f"{self.shown} stays as it is: blocks would leave it {self.psnr:.1f} dB, less than {LEAST_PSNR:g}"
        return f"{self.shown}: {'exact' if self.psnr == float('inf') else f'{self.psnr:.1f} dB'}"


def averaged_files(
    document: Document, plain: Sequence[PlainTexture], levels: int | None = None
) -> list[tuple[PlainTexture, bytes, PlainCost]]:
    """Gives each texture of a document a KTX 2 file of box-filtered levels, so many or all, and says what its blocks
    cost: level 0 is the image. Colours are averaged linearly, by opacity where they have one, and opacity that is
    tested against a cutoff keeps its coverage. InputError where an image cannot be read any more."""
    container = Ktx2File(GLB_TEXELS[0])
    about = json.dumps({"method": "linear", "pixel_filter": "box", "version": __version__})

    def encode(given: tuple[PlainTexture, Image]) -> tuple[PlainTexture, bytes, PlainCost]:
        texture, pixels = given
        chain = averaged(texture, pixels)[:levels]
        kinds = [COLOUR_ENCODING if texture.holds == COLOUR else UNIT] * 3 + [UNIT] * (pixels.shape[-1] - 3)
        layout = FileLayout("plain", tuple(FileChannel("plain", i, kind, "") for i, kind in enumerate(kinds)), False)
        wanted = quantised_levels(MapFile(container, layout, chain))
        made = container.texture(layout, wanted, about)
        cost = PlainCost(shown_by(document, texture), _psnr(made, wanted[0]))
        return texture, b"" if cost.stays else ktx2.encoded(made, supercompress=True), cost

    with temporary_folder() as folder, ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        images = Images(document, folder)
        return list(pool.map(encode, ((texture, _pixels(images, texture)) for texture in plain)))


def _pixels(images: Images, texture: PlainTexture) -> Image:
    """(H, W, 3), or 4 with the alpha that is read, in [0, 1], linear."""
    colours, alpha = images.linear(texture.image, texture.holds == COLOUR)
    return np.ascontiguousarray(
        np.concatenate([colours, alpha], -1) if texture.alpha and alpha is not None else colours
    )


def _psnr(made: GpuTexture, wanted: NDArray[np.generic]) -> float:
    """Of level 0 of a texture, which has been made of texels from 0 to 1."""
    (found,) = from_blocks(replace(made, levels=made.levels[:1]))
    error = np.subtract(found[..., : wanted.shape[-1]], wanted, dtype=np.float32)
    mean = float(np.square(error).mean(dtype=np.float64))
    return float("inf") if mean == 0 else float(-10 * np.log10(mean))


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
