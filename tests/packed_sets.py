"""Texture sets as files, packed in the ways that they come in, for the tests of what goes out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .command_line import run
from .input_files import bytes_of, encoded, height_field, write_image

SIZE = 16


def grey(seed: int, size: int = SIZE) -> np.ndarray:
    """(size, size) of 8-bit noise."""
    return np.random.default_rng(seed).integers(10, 245, (size, size)).astype(np.uint8)


def waves(seed: int, size: int = SIZE) -> np.ndarray:
    """(size, size) of slow 8-bit waves, others for every seed, that tile."""
    y, x = (np.mgrid[0:size, 0:size] + 0.5) / size * 2 * np.pi
    along = [(1, 0), (0, 1), (1, 1), (1, -1)][seed % 4]
    return bytes_of(0.5 + (0.2 + 0.02 * seed) * np.sin(along[0] * x + along[1] * y + 0.7 * seed))


AO, ROUGH, METAL, OTHER, OPACITY = (grey(seed) for seed in range(5))
COLOUR = np.random.default_rng(9).integers(10, 245, (SIZE, SIZE, 3)).astype(np.uint8)
NORMALS = height_field(SIZE, SIZE)


def write(folder: Path, **files: Any) -> Path:
    """A folder with the maps that are given by file stem, and base colour and normal where they are not."""
    folder.mkdir(parents=True)
    given = {"wood_base_color": COLOUR, "wood_normal_gl": encoded(NORMALS)} | files
    for stem, pixels in given.items():
        if pixels is not None:
            write_image(folder / f"{stem}.png", pixels)
    return folder


def orm(folder: Path, **others: Any) -> Path:
    return write(folder, wood_orm=np.stack([AO, ROUGH, METAL], -1), **others)


def every_map(folder: Path) -> Path:
    colours = np.dstack([waves(3), waves(6), waves(9)])
    opaque = np.dstack([COLOUR, OPACITY])
    return orm(folder, wood_base_color=opaque, wood_emissive=colours, wood_height=waves(11))


def tiles(folder: Path, **others: Any) -> Path:
    """1001 and 1002, of the same maps."""
    maps = {"wall_normal_gl": encoded(NORMALS), "wall_roughness": ROUGH} | others
    files = {f"{name}.{tile}": pixels for tile in (1001, 1002) for name, pixels in maps.items()}
    return write(folder, wood_base_color=None, wood_normal_gl=None, **files)


def baked(source: Path, out: Path, preset: str, *options: str) -> Path:
    """The folder of the stack that the command makes of a set, by `linear` unless options say otherwise."""
    chosen = options or ("--method", "linear")
    assert run("bake", source, "-o", out, "--preset", preset, *chosen)[0] == 0
    return out / source.name


def mask_map(folder: Path) -> Path:
    """Unity's: metallic, occlusion, detail mask, smoothness."""
    return write(folder, wood_mask_map=np.stack([METAL, AO, OTHER, ROUGH], -1))


def glossy_directx(folder: Path) -> Path:
    """Gloss in place of roughness, green down."""
    return write(folder, wood_normal_gl=None, wood_normal_dx=encoded(NORMALS, directx=True), wood_gloss=ROUGH)


def two_channels(folder: Path) -> Path:
    """A normal map of x and y alone."""
    return write(folder, wood_normal_gl=None, wood_normal=bytes_of((NORMALS + 1) / 2)[..., :2], wood_roughness=ROUGH)


def box_levels(level: np.ndarray) -> list[np.ndarray]:
    """Plain averages of 2 x 2 texels of a square whose side is a power of two, in float64."""
    levels = [level.astype(np.float64)]
    while levels[-1].shape[0] > 1:
        half = levels[-1].shape[0] // 2
        levels.append(levels[-1].reshape(half, 2, half, 2, *level.shape[2:]).mean((1, 3)))
    return levels
