"""Makes texture sets that shimmer: `python examples/showcase.py OUT [--size 1024] [--only NAME]`.

These are the surfaces that people complain about when they look at floors, walls and water: glossy, with bumps as small
as a few texels. They have ordinary glTF maps, tile, and are not stored here, because they are made in seconds. As the
sets of generate.py, each is a function of its size alone. A texel of a set of 1024 x 1024 is about 2 mm wide.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from generate import Image, band, cells, mix, noise, normal_map, run, smoothstep, srgb, texel_centres

_FINEST = 256
"""Highest frequency of the noise, in cycles per texture: waves of 2 texels in a set of 512 x 512, 4 in one of 1024."""


_noise = partial(noise, finest=_FINEST)


def _dielectric(height: int, width: int, color: Image, relief: Image, roughness: Image) -> dict[str, Image]:
    """The maps of a set without metal, its colour linear."""
    return {
        "base_color": srgb(np.broadcast_to(color, (height, width, 3))),
        "normal": normal_map(relief),
        "roughness": np.clip(np.broadcast_to(roughness, (height, width)), 0.045, 1),
        "metallic": np.zeros((height, width)),
    }


def _metal(height: int, width: int, color: Image, relief: Image, roughness: Image) -> dict[str, Image]:
    """The maps of a set that is metal all over, its colour linear."""
    return _dielectric(height, width, color, relief, roughness) | {"metallic": np.ones((height, width))}


def wet_asphalt(height: int, width: int) -> dict[str, Image]:
    """Stones that stick out of a film of water, and puddles that drown them.

    Water makes a surface darker and smooth: the film has a roughness of 0.14 on stones, and 0.05 where it stands.
    """
    nearest, _, which = cells(height, width, 110, np.random.default_rng(61))
    size = np.random.default_rng(62).uniform(0.5, 1, (110, 110))[which[..., 0], which[..., 1]]
    grain, bed = _noise(height, width, 63, band(90, 256)), noise(height, width, 64, band(2, 6))
    stone = 0.0042 * size * np.sqrt(np.clip(1 - np.square(nearest / 0.85), 0, 1)) + 0.00009 * grain + 0.0012 * bed
    level = 0.0008
    water = smoothstep(0.0006, -0.0002, stone - level)  # 1 where it stands
    ripple = 0.00001 * noise(height, width, 65, band(8, 40))
    shade = (0.018 + 0.03 * size) * (1 + 0.15 * noise(height, width, 66, band(20, 60)))
    color = mix(shade, 0.012, water)[..., None] * np.array([1.0, 0.98, 0.95])
    return _dielectric(height, width, color, mix(stone, level + ripple, water), mix(0.14 + 0.01 * grain, 0.05, water))


def embossed_steel(height: int, width: int) -> dict[str, Image]:
    """Sheet metal with round bumps in a hexagonal pattern."""
    u, v = texel_centres(height, width)
    columns, rows = 28, 32
    row = (v * rows).astype(int)
    x, y = (u * columns + 0.5 * (row % 2)) % 1 - 0.5, (v * rows) % 1 - 0.5
    radius = np.hypot(x / columns, y / rows) * columns
    bump = 0.0045 * np.square(np.clip(1 - np.square(radius / 0.42), 0, 1))
    rolled = _noise(height, width, 71, lambda fu, fv: np.exp(-np.square(fv / 3.0)) * (fu > 20))
    dents = noise(height, width, 72, band(2, 6))
    color = np.array([0.56, 0.57, 0.58]) * (1 + 0.02 * rolled)[..., None]
    return _metal(height, width, color, bump + 0.000015 * rolled + 0.0006 * dents, 0.2 + 0.01 * rolled)


def brushed_aluminium(height: int, width: int) -> dict[str, Image]:
    """Marks of a brush that went along u. The maps are isotropic: the marks are in the normals."""
    marks = _noise(height, width, 81, lambda fu, fv: np.exp(-np.square(fu / 4.0)) * (np.abs(fv) > 24))
    dents = noise(height, width, 82, band(2, 8))
    color = np.array([0.91, 0.92, 0.92]) * (0.93 + 0.02 * marks)[..., None]
    return _metal(height, width, color, 0.00022 * marks + 0.0002 * dents, 0.16 + 0.015 * marks)


def black_tiles(height: int, width: int) -> dict[str, Image]:
    """Small tiles with a black glaze, wavy and each tilted a little, between matte joints."""
    u, v = texel_centres(height, width)
    count = 24
    row, column = (v * count).astype(int), (u * count).astype(int)
    x, y = u * count % 1 - 0.5, v * count % 1 - 0.5
    edge = 0.5 - np.maximum(np.abs(x), np.abs(y))  # in tiles
    glaze = smoothstep(0.04, 0.08, edge)
    tilt = np.random.default_rng(91).normal(0, 0.03, (2, count, count))[:, row, column]
    pillow = -0.001 * np.exp(-np.maximum(edge - 0.04, 0) / 0.05)
    waves = 0.00016 * noise(height, width, 92, band(20, 64))
    grain = _noise(height, width, 93, band(80, 256))
    relief = mix(-0.0018 + 0.0001 * grain, pillow + waves + (tilt[0] * x + tilt[1] * y) / count, glaze)
    color = mix(np.array([0.10, 0.10, 0.095]), np.array([0.006, 0.006, 0.007]), glaze)
    return _dielectric(height, width, color, relief, mix(0.85 + 0.03 * grain, 0.06, glaze))


def pebbled_leather(height: int, width: int) -> dict[str, Image]:
    """Polished leather with a pebbled grain: every pebble is a small lens, between creases."""
    nearest, second, which = cells(height, width, 64, np.random.default_rng(101))
    crease = smoothstep(0.35, 0.0, second - nearest + 0.05 * noise(height, width, 102, band(20, 64)))
    rise = np.random.default_rng(103).uniform(0.6, 1, (64, 64))[which[..., 0], which[..., 1]]
    pores, folds = _noise(height, width, 104, band(90, 256)), noise(height, width, 105, band(2, 8))
    relief = 0.0034 * rise * (1 - crease) - 0.004 * np.square(nearest) * (1 - crease) + 0.00004 * pores
    color = np.array([0.055, 0.022, 0.012]) * (1 - 0.5 * crease + 0.08 * folds)[..., None]
    return _dielectric(height, width, color, relief + 0.0012 * folds, 0.24 + 0.25 * crease + 0.01 * pores)


def sparkling_snow(height: int, width: int) -> dict[str, Image]:
    """Snow of matte grains, and a few crystals among them that mirror the light, each in a direction of its own."""
    count = 200
    _, _, which = cells(height, width, count, np.random.default_rng(111))
    rng = np.random.default_rng(112)
    crystal = (rng.random((count, count)) < 0.05)[which[..., 0], which[..., 1]]
    facets = np.tan(np.clip(rng.normal(0, 0.35, (2, count, count)), -1, 1))[:, which[..., 0], which[..., 1]]
    drifts, grain = noise(height, width, 113, band(2, 8)), _noise(height, width, 114, band(60, 256))
    maps = _dielectric(
        height, width, np.array([0.88, 0.90, 0.93]) * (1 + 0.02 * drifts)[..., None],
        0.003 * drifts + 0.00025 * grain, np.where(crystal, 0.08, 0.65 + 0.03 * grain),
    )  # fmt: skip
    mirrors = np.stack([*facets, np.ones((height, width))], -1)
    mirrors = (mirrors / np.linalg.norm(mirrors, axis=-1, keepdims=True) + 1) / 2
    return maps | {"normal": np.where(crystal[..., None], mirrors, maps["normal"])}


def ocean(height: int, width: int) -> dict[str, Image]:
    """Waves of a fresh breeze along u: the spectrum of a sea that has grown to its wind, from 2 cycles to the finest.

    Heights have amplitudes of k^-2 at a wave number k (Phillips 1958: a spectrum of k^-4), and waves across the wind
    are weaker. The mean square of slopes is what Cox and Munk (1954) measured at 7 m/s, 0.003 + 0.00512 times that.
    """

    def spectrum(fu: Image, fv: Image) -> Image:
        k = np.maximum(np.hypot(fu, fv), 1)
        return np.exp(-np.square(2 / k)) / np.square(k) * (0.15 + 0.85 * np.square(fu / k))

    waves = _noise(height, width, 121, spectrum)
    foam = smoothstep(1.9, 2.6, waves + 0.35 * _noise(height, width, 122, band(40, 200)))
    color = mix(np.array([0.004, 0.018, 0.026]), np.array([0.5, 0.53, 0.55]), 0.6 * foam)
    return _dielectric(height, width, color, 0.0040 * waves, mix(0.05, 0.6, foam))


SHOWCASE: Mapping[str, Callable[[int, int], dict[str, Image]]] = {
    "wet_asphalt": wet_asphalt,
    "embossed_steel": embossed_steel,
    "brushed_aluminium": brushed_aluminium,
    "black_tiles": black_tiles,
    "pebbled_leather": pebbled_leather,
    "sparkling_snow": sparkling_snow,
    "ocean": ocean,
}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Make texture sets that shimmer.")
    parser.add_argument("out", type=Path, help="a folder, which takes a folder a set")
    run(SHOWCASE, 1024, parser)


if __name__ == "__main__":
    main()
