"""Makes docs/before_after.png: a receding plane with plain MIP maps, with mipbake's, and supersampled.

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

WIDTH, HEIGHT = 420, 300
CAMERA = np.array([0.0, 0.0, 1.0])  # above the plane, looking along +Y and down
PITCH = np.radians(24.0)
FIELD_OF_VIEW = np.radians(50.0)
TILES = 1.1  # repetitions of the texture set per unit of the plane: about 1:1 at the bottom edge of the picture
LIGHTS = np.array([[0.0, 1.0, 0.42], [-0.9, 0.8, 0.6], [0.8, 1.0, 0.9]])
LIGHT_RADIANCE = (2.2, 0.9, 0.9)
EXPOSURE = 0.9

Array = NDArray[np.float64]


def ground(pixels: Array) -> tuple[Array, Array]:
    """Where the plane is seen: texture coordinates (P, 2) and unit view vectors (P, 3), for pixel positions (P, 2)."""
    scale = np.tan(FIELD_OF_VIEW / 2) / (WIDTH / 2)
    x, y = ((pixels - [WIDTH / 2, HEIGHT / 2]) * scale * [1, -1]).T
    forward = np.array([0, np.cos(PITCH), -np.sin(PITCH)])
    up = np.array([0, np.sin(PITCH), np.cos(PITCH)])
    direction = forward + x[:, None] * [1, 0, 0] + y[:, None] * up
    distance = -CAMERA[2] / np.minimum(direction[:, 2], -1e-3)
    hit = CAMERA + distance[:, None] * direction
    view = -direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return hit[:, :2] * [TILES, -TILES], view


def shade(texels: NDArray[np.float32], model: str, view: Array) -> Array:
    """Sum over the lights, (P, 3): every pixel has a view of its own, so texels and views go in as a batch."""
    total = np.zeros((len(texels), 3))
    light = LIGHTS / np.linalg.norm(LIGHTS, axis=-1, keepdims=True)
    for direction, radiance in zip(light, LIGHT_RADIANCE, strict=True):
        lights = np.broadcast_to(direction.astype(np.float32), (len(texels), 1, 3))
        views = view[:, None].astype(np.float32)
        total += np.pi * radiance * shading.shade(model, texels[:, None], lights, views)[:, 0, 0]
    return total


def pixel_centres() -> Array:
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([column.ravel() + 0.5, row.ravel() + 0.5], -1)


def once_per_pixel(levels: Sequence[NDArray[np.float32]], model: str) -> Array:
    """What an engine shows: one trilinear lookup at the lod of the longer footprint axis, shaded once."""
    centres = pixel_centres()
    uv, view = ground(centres)
    texels = levels[0].shape[1::-1]
    footprint = [np.linalg.norm((ground(centres + step)[0] - uv) * texels, axis=-1) for step in ([1, 0], [0, 1])]
    lod = np.log2(np.maximum(*footprint))
    return shade(sampling.sample(levels, uv, lod, ("wrap", "wrap")), model, view).reshape(HEIGHT, WIDTH, 3)


def supersampled(stored: NDArray[np.float32], model: str, pixel_filter: str, samples: int) -> Array:
    """The reference: level 0 of the source under the pixel filter, `samples` random positions in every pixel."""
    rng = np.random.default_rng(0)
    centres, kernel = pixel_centres(), filter_named(pixel_filter)
    total = np.zeros((len(centres), 3))
    for _ in range(samples):
        offset, weight = kernel.offsets(rng.random(centres.shape))
        uv, view = ground(centres + offset)
        total += weight.prod(-1)[:, None] * shade(sampling.sample([stored], uv, 0.0, ("wrap", "wrap")), model, view)
    return (total / samples).reshape(HEIGHT, WIDTH, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--samples", type=int, default=256)
    options = parser.parse_args()
    texture_set = mipbake.load(options.folder)
    model = texture_set.source_model
    plain = mipbake.bake(texture_set, method="linear", pixel_filter="box")
    neural = mipbake.bake(texture_set)
    panels = [
        once_per_pixel(plain.levels, plain.model),
        once_per_pixel(neural.levels, neural.model),
        supersampled(texture_set.material(model), model, neural.provenance.pixel_filter, options.samples),
    ]
    for name, panel in zip(("plain MIP maps", "mipbake"), panels, strict=False):
        snr = 10 * np.log10((panels[2] ** 2).sum() / ((panel - panels[2]) ** 2).sum())
        print(f"{name}: {snr:.1f} dB against the reference")
    gap = np.ones((HEIGHT, 6, 3))
    exposed = [srgb_encode(np.clip(1 - np.exp(-EXPOSURE * panel), 0, 1)) for panel in panels]
    image = np.concatenate([exposed[0], gap, exposed[1], gap, exposed[2]], 1)
    write_png(options.picture, np.round(image * 255).astype(np.uint8))


def write_png(path: Path, image: NDArray[np.uint8]) -> None:
    import OpenImageIO as oiio  # noqa: N813

    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(image.shape[1], image.shape[0], 3, "uint8"))
    out.write_image(np.ascontiguousarray(image))
    out.close()


if __name__ == "__main__":
    main()
