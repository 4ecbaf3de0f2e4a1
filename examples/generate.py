"""Makes the example texture sets: `python examples/generate.py [--size 256] [--only NAME] [OUT]`.

Procedural materials that tile, chosen because averaging their maps changes how they look: bumps smaller than a pixel
become a flat mirror, crossed brush marks become a blur. The last, `knurled_plate`, is there to fail: its pixels show
several lobes, which no texel of one lobe does. Every set is a function of its size alone, because seeds are fixed: it
is the same material at any resolution.

Directions follow glTF: +X along +u (right), +Y up in the image, so the normal of a height h(u, v), v down, is
(-dh/du, dh/dv, 1) normalised. Lengths are in units of the texture.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float64]
"""(H, W) or (H, W, C), values as stored in the file before quantisation: 0 to 1."""

_FINEST = 64
"""Highest frequency of the noise, in cycles per texture: what a 128 texel map can just hold."""


def texel_centres(height: int, width: int) -> tuple[Image, Image]:
    """u and v, each (H, W), of the texel centres; v points down."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    return u, v


def noise(
    height: int, width: int, seed: int, envelope: Callable[[Image, Image], Image], finest: int = _FINEST
) -> Image:
    """Periodic Gaussian noise, (H, W), mean 0 and variance 1 over its whole spectrum.

    The spectrum is drawn once for frequencies up to `finest` and evaluated at any size; frequencies that the size
    cannot hold are left out. `envelope(fu, fv)` is the amplitude at a frequency in cycles per texture.
    """
    rng = np.random.default_rng(seed)
    fv, fu = np.meshgrid(np.arange(-finest, finest + 1), np.arange(finest + 1), indexing="ij")
    draws = rng.normal(size=fu.shape) + 1j * rng.normal(size=fu.shape)
    draws[(fu == 0) & (fv <= 0)] = 0  # the mean, and the half axis that is the mirror image of the other half
    amplitude = envelope(fu.astype(float), fv.astype(float))
    amplitude = np.where((fu == 0) & (fv == 0), 0, amplitude) * draws
    amplitude /= np.sqrt(2 * np.square(np.abs(amplitude)).sum())
    along_u = np.exp(2j * np.pi * np.outer(np.arange(finest + 1), (np.arange(width) + 0.5) / width))
    along_v = np.exp(2j * np.pi * np.outer((np.arange(height) + 0.5) / height, np.arange(-finest, finest + 1)))
    holds = (fu < max(width / 2, 0.5)) & (np.abs(fv) < max(height / 2, 0.5))
    return 2 * np.real(along_v @ (amplitude * holds) @ along_u)


def band(low: float, high: float) -> Callable[[Image, Image], Image]:
    """Envelope of isotropic noise between two frequencies, with soft ends."""
    return lambda fu, fv: np.exp(
        -np.square(np.log(np.maximum(np.hypot(fu, fv), 1e-3) / np.sqrt(low * high)))
        / (2 * np.square(np.log(high / low) / 2))
    )


def cells(height: int, width: int, count: int, rng: np.random.Generator) -> tuple[Image, Image, NDArray[np.int64]]:
    """Of `count` x `count` scattered points, the distances to the nearest two in units of a cell, each (H, W), and
    (H, W, 2) row and column of the nearest.

    Where the distances are the same, two cells meet.
    """
    u, v = texel_centres(height, width)
    jitter_u, jitter_v = rng.uniform(-0.42, 0.42, (2, count, count))
    nearest, second = np.full((2, height, width), np.inf)
    which = np.zeros((height, width, 2), np.int64)
    for down, right in np.ndindex(5, 5):  # at most two cells away
        row, column = (v * count).astype(int) + down - 2, (u * count).astype(int) + right - 2
        centre_u = column + 0.5 * (row % 2) + jitter_u[row % count, column % count]
        centre_v = row + 0.5 + jitter_v[row % count, column % count]
        distance = np.hypot(u * count - centre_u, v * count - centre_v)
        np.copyto(which, np.stack([row % count, column % count], -1), where=(distance < nearest)[..., None])
        second = np.minimum(second, np.maximum(nearest, distance))
        nearest = np.minimum(nearest, distance)
    return nearest, second, which


def normal_map(relief: Image) -> Image:
    """(H, W, 3) stored normals, (n + 1) / 2 in the OpenGL convention, of a periodic relief (H, W)."""
    height, width = relief.shape
    du = (np.roll(relief, -1, 1) - np.roll(relief, 1, 1)) * width / 2
    dv = (np.roll(relief, -1, 0) - np.roll(relief, 1, 0)) * height / 2
    normal = np.stack([-du, dv, np.ones_like(du)], -1)
    return (normal / np.linalg.norm(normal, axis=-1, keepdims=True) + 1) / 2


def mix(a: Image | float, b: Image | float, t: Image) -> Image:
    """a where t is 0, b where t is 1; t gains a channel axis where a or b is a colour (3,)."""
    colour = max(np.ndim(a), np.ndim(b)) in (1, 3)
    t = t[..., None] if colour else t
    return np.asarray(a) * (1 - t) + np.asarray(b) * t


def smoothstep(low: float, high: float, x: Image) -> Image:
    """0 below low, 1 above high, smooth between; low > high falls instead of rising."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def srgb(linear: Image) -> Image:
    """sRGB encoding (IEC 61966-2-1) of linear values, clipped to 0..1."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def hammered_copper(height: int, width: int) -> dict[str, Image]:
    """Overlapping hammer blows in polished copper, dark oxide on the ridges between them."""
    u, v = texel_centres(height, width)
    rng = np.random.default_rng(11)
    count = 11
    rows, columns = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    centre_u = (columns + 0.5 * (rows % 2) + rng.uniform(-0.32, 0.32, rows.shape)) / count
    centre_v = (rows + rng.uniform(-0.32, 0.32, rows.shape)) / count
    depth = rng.uniform(0, 0.0016, rows.shape)
    radius = 0.13  # of the hammer's face
    sharpness = 3500.0
    # A soft minimum of spherical cups: each blow digs its own, and the ridge between two is slightly rounded.
    total = np.zeros((height, width))
    for cu, cv, cd in zip(centre_u.ravel(), centre_v.ravel(), depth.ravel(), strict=True):
        du = (u - cu + 0.5) % 1 - 0.5
        dv = (v - cv + 0.5) % 1 - 0.5
        total += np.exp(-sharpness * ((du * du + dv * dv) / (2 * radius) + cd))
    cups = -np.log(total) / sharpness
    grain = noise(height, width, 12, band(24, 60))
    relief = 0.65 * cups + 0.0001 * grain
    ridge = smoothstep(0.0086, 0.0150, cups + 0.0008 * noise(height, width, 13, band(4, 20)))
    polish = noise(height, width, 14, band(2, 12))
    clean = np.array([0.86, 0.50, 0.37]) * (1 + 0.03 * polish[..., None])
    return {
        "base_color": srgb(mix(clean, np.array([0.16, 0.075, 0.05]), 0.85 * ridge)),
        "normal": normal_map(relief),
        "roughness": np.clip(0.27 + 0.03 * polish + 0.30 * ridge + 0.012 * grain, 0.06, 1),
        "metallic": mix(1.0, 0.45, ridge),
        "height": np.clip((relief + 0.001) / 0.015, 0, 1),
    }


def brushed_steel(height: int, width: int) -> dict[str, Image]:
    """Steel brushed in square fields, every other field across its neighbours, with fine grooves between the fields.

    KHR_materials_anisotropy stretches the highlight along the direction, which is across the brush marks.
    """
    u, v = texel_centres(height, width)
    fields = 4
    rng = np.random.default_rng(21)
    angle = np.where(np.add.outer(np.arange(fields), np.arange(fields)) % 2, np.pi / 2, 0.0)
    angle = angle + rng.uniform(-0.08, 0.08, angle.shape)
    shade = rng.normal(0, 0.018, angle.shape)
    row, column = (v * fields).astype(int), (u * fields).astype(int)
    across = (angle + np.pi / 2)[row, column]  # of the marks; counter-clockwise from +X with +Y up

    def streaks(seed: int) -> Image:
        horizontal = noise(height, width, seed, lambda fu, fv: np.exp(-np.square(fu / 3.0)) * (np.abs(fv) > 12))
        vertical = noise(height, width, seed + 1, lambda fu, fv: np.exp(-np.square(fv / 3.0)) * (np.abs(fu) > 12))
        return np.where((row + column) % 2, vertical, horizontal)

    marks, gloss = streaks(22), streaks(24)
    edge = np.minimum(np.abs((u * fields + 0.5) % 1 - 0.5), np.abs((v * fields + 0.5) % 1 - 0.5))
    groove = smoothstep(0.05, 0.015, edge)
    flat = 1 - groove
    relief = 0.00042 * marks * flat - 0.004 * groove
    strength = np.clip((0.62 + 0.05 * gloss) * mix(1.0, 0.25, groove), 0, 1)
    direction = np.stack([np.cos(across), np.sin(across)], -1)
    steel = np.array([0.57, 0.56, 0.55]) * (1 + shade[row, column] + 0.05 * marks)[..., None]
    return {
        "base_color": srgb(mix(steel, np.array([0.10, 0.095, 0.09]), groove)),
        "normal": normal_map(relief),
        "roughness": np.clip(0.24 + 0.03 * gloss + 0.4 * groove, 0.06, 1),
        "metallic": mix(1.0, 0.8, groove),
        "anisotropy": np.concatenate([(direction + 1) / 2, strength[..., None]], -1),
    }


def glazed_tiles(height: int, width: int) -> dict[str, Image]:
    """Hand-made tiles in a running bond: wavy, mirror-like glaze, each tile a little tilted, in rough grout."""
    u, v = texel_centres(height, width)
    rows, columns = 6, 3
    rng = np.random.default_rng(31)
    row = (v * rows).astype(int)
    along = u * columns + 0.5 * (row % 2)
    column = along.astype(int) % columns
    x, y = along % 1 - 0.5, v * rows % 1 - 0.5  # position within a tile
    wander = 0.012 * noise(height, width, 32, band(4, 16))
    gap = np.minimum((0.5 - np.abs(x)) / columns, (0.5 - np.abs(y)) / rows) + 0.12 * wander
    glaze = smoothstep(0.008, 0.0125, gap)
    tilt = rng.normal(0, 0.018, (2, rows, columns))
    pillow = -0.010 * np.exp(-np.maximum(gap - 0.008, 0) / 0.007)
    orange_peel = 0.00026 * noise(height, width, 33, band(14, 48)) + 0.0008 * noise(height, width, 34, band(3, 9))
    tile = pillow + orange_peel + tilt[0, row, column] * x / columns + tilt[1, row, column] * y / rows
    grain = noise(height, width, 35, band(20, 64))
    relief = mix(-0.014 + 0.0007 * grain, tile, glaze)
    hue = rng.uniform(-1, 1, (rows, columns))[row, column]
    pooled = smoothstep(0.035, 0.009, gap)  # glaze runs thin, and paler, towards the edges
    sea = mix(np.array([0.012, 0.13, 0.17]), np.array([0.02, 0.24, 0.20]), 0.5 + 0.5 * hue)
    sea = sea * (1 + 0.10 * noise(height, width, 36, band(2, 10)))[..., None]
    enamel = mix(sea, np.array([0.22, 0.42, 0.38]), 0.55 * pooled)
    grout = np.array([0.46, 0.42, 0.36]) * (1 + 0.10 * grain)[..., None]
    return {
        "base_color": srgb(mix(grout, enamel, glaze)),
        "normal": normal_map(relief),
        "roughness": np.clip(mix(0.86 + 0.04 * grain, 0.20 + 0.06 * pooled, glaze), 0.06, 1),
        "metallic": np.zeros((height, width)),
        "ao": np.clip(mix(0.55, 1.0, smoothstep(0.004, 0.022, gap)), 0, 1),
        "height": np.clip((relief + 0.02) / 0.026, 0, 1),
    }


def lacquered_leather(height: int, width: int) -> dict[str, Image]:
    """Oxblood leather under clear lacquer: smooth scales, and creases between them that turn every way."""
    nearest, second, _ = cells(height, width, 22, np.random.default_rng(41))
    crease = smoothstep(0.30, 0.0, second - nearest + 0.05 * noise(height, width, 42, band(10, 40)))
    pores, hide = noise(height, width, 43, band(30, 64)), noise(height, width, 44, band(2, 7))
    dye = np.array([0.06, 0.004, 0.0035]) * (1 + 0.06 * hide[..., None])
    return {
        "base_color": srgb(mix(dye, 0.45 * dye, crease)),
        "normal": normal_map(-0.0034 * crease + 0.00016 * pores + 0.0012 * hide),
        "roughness": np.clip(0.25 + 0.25 * crease + 0.03 * hide + 0.015 * pores, 0.06, 1),
        "metallic": np.zeros((height, width)),
    }


def knurled_plate(height: int, width: int) -> dict[str, Image]:
    """A steel plate knurled to small pyramids, their four faces polished, with a smooth disc in the middle.

    After figure 8 of Kemppinen et al. 2023. The faces tilt by 14 degrees and mirror within 2, so a pixel that holds a
    pyramid shows four lobes, 20 and 28 degrees apart in normals, and little between them: one lobe misses all four or
    covers what is dark.
    """
    u, v = texel_centres(height, width)
    pyramids, slope = 15, 0.25
    along, across = (u + v) * pyramids, (u - v) * pyramids
    valley = 0.5 - np.maximum(np.abs(along % 1 - 0.5), np.abs(across % 1 - 0.5))  # 0 in the grooves, 0.5 at the tips
    radius = np.hypot(u - 0.5, v - 0.5)
    disc = smoothstep(0.13, 0.11, radius)
    rim = np.exp(-np.square((radius - 0.12) / 0.006))
    relief = valley * slope / (pyramids * np.sqrt(2)) * (1 - disc)
    polish = noise(height, width, 51, band(2, 12))
    steel = np.array([0.60, 0.59, 0.57]) * (1 + 0.03 * polish[..., None])
    return {
        "base_color": srgb(mix(steel, np.array([0.16, 0.15, 0.14]), 0.8 * rim)),
        "normal": normal_map(relief),
        "roughness": np.clip(0.2 + 0.02 * polish + 0.3 * rim, 0.06, 1),
        "metallic": np.ones((height, width)),
    }


SETS: Mapping[str, Callable[[int, int], dict[str, Image]]] = {
    "hammered_copper": hammered_copper,
    "brushed_steel": brushed_steel,
    "glazed_tiles": glazed_tiles,
    "lacquered_leather": lacquered_leather,
    "knurled_plate": knurled_plate,
}


def quantised(maps: Mapping[str, Image]) -> dict[str, NDArray[np.uint8]]:
    """Maps in 8 bits, as stored."""
    return {file: np.round(np.clip(image, 0, 1) * 255).astype(np.uint8) for file, image in maps.items()}


def make(name: str, height: int = 256, width: int = 256) -> dict[str, NDArray[np.uint8]]:
    """Maps of a set by file name without suffix: (H, W) or (H, W, 3), 8 bits as stored."""
    return quantised(SETS[name](height, width))


def write(name: str, folder: Path, height: int = 256, width: int = 256) -> list[Path]:
    """Makes a set and writes each map to folder/<map>.png; returns the files."""
    return store(make(name, height, width), folder)


def store(maps: Mapping[str, NDArray[np.uint8]], folder: Path) -> list[Path]:
    """Writes each map to folder/<map>.png; returns the files."""
    import OpenImageIO

    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for file, pixels in maps.items():
        path = folder / f"{file}.png"
        image = np.atleast_3d(pixels)
        out = OpenImageIO.ImageOutput.create(str(path))
        spec = OpenImageIO.ImageSpec(image.shape[1], image.shape[0], image.shape[-1], "uint8")
        spec.attribute("png:compressionLevel", 9)
        if out is None or not (
            out.open(str(path), spec) and out.write_image(np.ascontiguousarray(image)) and out.close()
        ):
            raise OSError(out.geterror() if out else OpenImageIO.geterror())
        files.append(path)
    return files


def texels(text: str) -> int:
    """A side of maps, of the command line."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, got {text!r}")
    return int(text)


def run(sets: Mapping[str, Callable[[int, int], dict[str, Image]]], size: int, parser: argparse.ArgumentParser) -> None:
    """The command line, of which `parser` knows the folder `out`: writes one of the sets, or all."""
    parser.add_argument("--size", type=texels, default=size, help="texels along both sides (default: %(default)s)")
    parser.add_argument("--only", choices=sets, help="make one set")
    options = parser.parse_args()
    for name in [options.only] if options.only else sets:
        for path in store(quantised(sets[name](options.size, options.size)), options.out / name):
            print(path)


if __name__ == "__main__":
    made = argparse.ArgumentParser(description="Make the example texture sets.")
    made.add_argument("out", type=Path, nargs="?", default=Path(__file__).parent, help="default: this folder")
    run(SETS, 256, made)
