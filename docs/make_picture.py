"""Makes docs/before_after.png: a lit surface from two distances, with plain MIP maps, with mipbake's, and supersampled.

python docs/make_picture.py examples/hammered_copper docs/before_after.png
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import mipbake
from mipbake import sampling, shading
from mipbake.io.layout import srgb_encode
from mipbake.prefilter.pixel_filter import filter_named

WIDTH, HEIGHT = 320, 200
LODS = (1.0, 4.0)  # near and far: a pixel covers 2 and 16 texels
LIGHT = np.array([0.08, 0.1, 0.55])  # position above the picture's middle, in picture widths
SKY = np.array([[0.5, 0.3, 0.8], [-0.6, 0.2, 0.75], [0.1, -0.7, 0.7]])
SKY_RADIANCE = 0.08  # of each of the three, next to 1 for the light

Array = NDArray[np.float64]


def shade(texels: NDArray[np.float32], model: str, pixels: Array) -> Array:
    """(P, 3): seen straight from above, lit by a near lamp, so every pixel has a light direction of its own."""
    place = np.concatenate([(pixels / WIDTH - [0.5, 0.5 * HEIGHT / WIDTH]) * [1, -1], np.zeros((len(pixels), 1))], -1)
    to_lamp = LIGHT - place
    lamp = to_lamp / np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    sky = np.broadcast_to(SKY / np.linalg.norm(SKY, axis=-1, keepdims=True), (len(pixels), *SKY.shape))
    light = np.concatenate([lamp[:, None], sky], 1).astype(np.float32)
    view = np.broadcast_to(np.array([0, 0, 1], np.float32), light.shape)
    radiance = shading.shade(model, texels[:, None], light, view)[:, :, 0].astype(np.float64)
    return np.pi * (radiance[:, 0] + SKY_RADIANCE * radiance[:, 1:].sum(1))


def texture_coordinates(pixels: Array, lod: float, size: tuple[int, int]) -> Array:
    """(P, 2) for pixel positions (P, 2), the textures repeated; size is (height, width) of level 0."""
    return pixels * 2**lod / [size[1], size[0]]


def pixel_centres() -> Array:
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([column.ravel() + 0.5, row.ravel() + 0.5], -1)


def once_per_pixel(levels: Sequence[NDArray[np.float32]], model: str, lod: float) -> Array:
    """What an engine shows: one trilinear lookup a pixel, shaded once."""
    centres = pixel_centres()
    uv = texture_coordinates(centres, lod, levels[0].shape[:2])
    finest, *coarser = (level[None] for level in levels)
    texels = sampling.texture(finest, uv[None, None], mip_level_bias=[[[lod]]], mip=coarser)[0, 0]
    return shade(texels, model, centres).reshape(HEIGHT, WIDTH, 3)


def supersampled(stored: NDArray[np.float32], model: str, pixel_filter: str, lod: float, samples: int) -> Array:
    """The reference: level 0 of the source under the pixel filter, `samples` random positions in every pixel."""
    rng = np.random.default_rng(0)
    centres, kernel = pixel_centres(), filter_named(pixel_filter)
    total = np.zeros((len(centres), 3))
    for _ in range(samples):
        offset, weight = kernel.offsets(rng.random(centres.shape))
        uv = texture_coordinates(centres + offset, lod, stored.shape[:2])
        texels = sampling.texture(stored[None], uv[None, None])[0, 0]
        total += weight.prod(-1)[:, None] * shade(texels, model, centres)
    return (total / samples).reshape(HEIGHT, WIDTH, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--samples", type=int, default=256)
    options = parser.parse_args()
    texture_set = mipbake.load(options.folder)
    source = texture_set.source_model
    plain = mipbake.bake(texture_set, method="linear", pixel_filter="box")
    neural = mipbake.bake(texture_set)
    kernel = neural.provenance.pixel_filter
    rows = []
    for lod in LODS:
        reference = supersampled(texture_set.material(source), source, kernel, lod, options.samples)
        panels = [once_per_pixel(stack.levels, stack.model, lod) for stack in (plain, neural)]
        for name, panel in zip(("plain MIP maps", "mipbake"), panels, strict=True):
            snr = 10 * np.log10((reference**2).sum() / ((panel - reference) ** 2).sum())
            print(f"lod {lod:g}, {name}: {snr:.1f} dB against the reference")
        exposure = 1.6 / np.percentile(reference, 97)
        shown = [srgb_encode(1 - np.exp(-exposure * panel)) for panel in (*panels, reference)]
        gap = np.ones((HEIGHT, 6, 3))
        rows += [np.concatenate([shown[0], gap, shown[1], gap, shown[2]], 1), np.ones((6, 3 * WIDTH + 12, 3))]
    write_png(options.picture, np.round(np.concatenate(rows[:-1]) * 255).astype(np.uint8))


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    import OpenImageIO as oiio  # noqa: N813

    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(image.shape[1], image.shape[0], 3, "uint8"))
    out.write_image(np.ascontiguousarray(image))
    out.close()


if __name__ == "__main__":
    main()
