"""Periodic fields and reliefs from random numbers, which generated materials are made of.

A relief is a height field and a region: where a second substance lies, or what lies deep. The kinds are chosen to
differ in what prefiltering finds hard: isotropic and one-sided bumps, sharp edges, plainly smooth surfaces.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]  # (size, size), periodic
Relief = Callable[[np.random.Generator, int], tuple[Field, Field]]


def noise(rng: np.random.Generator, size: int, cutoff: float, stretch: float = 1.0, angle: float = 0.0) -> Field:
    """Gaussian noise low-passed at `cutoff` cycles a texel, `stretch` times longer along `angle`; variance 1."""
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij")
    along, across = np.cos(angle) * fx + np.sin(angle) * fy, np.cos(angle) * fy - np.sin(angle) * fx
    spectrum = np.exp(-0.5 * (np.square(along * stretch) + np.square(across)) / cutoff**2)
    return standardise(np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * spectrum).real)


def fractal(rng: np.random.Generator, size: int) -> Field:
    """Noise whose spectrum falls as a random power of frequency."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size), indexing="ij"))
    spectrum = np.maximum(frequency, 1 / size) ** -rng.uniform(1.0, 2.2)
    return standardise(np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * spectrum).real)


def standardise(field: Field) -> Field:
    out: Field = (field - field.mean()) / max(float(field.std()), 1e-9)
    return out


def step(field: Field, sharpness: float) -> Field:
    """0 to 1 over about 2 / sharpness of the field's value."""
    return 1 / (1 + np.exp(-np.clip(4 * sharpness * field, -40, 40)))


def normals(height: Field, slope: float) -> Field:
    """Unit normals (size, size, 3) of a height field scaled to that root-mean-square slope; +Y is up in the image."""
    dx = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / 2
    dy = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / 2
    scale = slope / max(float(np.sqrt(np.mean(dx * dx + dy * dy))), 1e-9)
    normal: Field = np.stack([-dx * scale, -dy * scale, np.ones_like(dx)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return normal


def patches(rng: np.random.Generator, size: int) -> Field:
    """Region mask: blotches of a second substance, often none."""
    if rng.random() < 0.4:
        return np.zeros((size, size))
    return step(noise(rng, size, rng.uniform(0.01, 0.1)) + rng.uniform(-1, 1), rng.uniform(1, 20))


def bumps(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    return noise(rng, size, np.exp(rng.uniform(np.log(0.02), np.log(0.25)))), patches(rng, size)


def rock(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    height = fractal(rng, size)
    return height, step(height + rng.uniform(-1.5, 1.5), rng.uniform(0.5, 8))


def brushed(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    angle = rng.integers(4) * np.pi / 4 if rng.random() < 0.6 else rng.uniform(0, np.pi)
    return noise(rng, size, rng.uniform(0.1, 0.5), rng.uniform(8, 60), angle), patches(rng, size)


def tiles(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    """Tiles or bricks with joints; each tile tilted a little."""
    rows, columns = int(rng.integers(2, 13)), int(rng.integers(2, 13))
    y, x = np.meshgrid(np.arange(size) / size * rows, np.arange(size) / size * columns, indexing="ij")
    row = np.floor(y).astype(np.int64) % rows
    x = (x + rng.choice([0.0, 0.5]) * (row % 2)) % columns
    column = np.floor(x).astype(np.int64) % columns
    edge = np.minimum(0.5 - abs(y % 1 - 0.5), (0.5 - abs(x % 1 - 0.5)) * rows / columns)
    tile = step((edge - rng.uniform(0.02, 0.1)) * size / rows, rng.uniform(0.15, 1.0))
    tilt = rng.normal(0, rng.uniform(0, 0.6), (3, rows, columns))[:, row, column]
    surface = 1 + 0.3 * (tilt[0] * (x % 1 - 0.5) + tilt[1] * (y % 1 - 0.5)) + 0.1 * tilt[2]
    return tile * surface, 1 - tile


def weave(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    """Plain weave: threads over and under each other; the region is where those lie on top that run up and down."""
    threads = 2 * int(rng.integers(4, 33))
    y, x = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    u, v = x / size * threads, y / size * threads
    over = np.where((np.floor(u) + np.floor(v)) % 2 == 0, 1.0, -1.0)
    warp = np.sqrt(np.maximum(0, 1 - np.square(2 * (u % 1) - 1))) + 0.5 * over * np.sin(np.pi * (v % 1))
    weft = np.sqrt(np.maximum(0, 1 - np.square(2 * (v % 1) - 1))) - 0.5 * over * np.sin(np.pi * (u % 1))
    fibres = rng.uniform(0, 0.2) * noise(rng, size, 0.4)
    return np.maximum(warp, weft) + fibres, step(warp - weft, 8.0)


def woven(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    """A weave whose second substance is half of the time in the threads of one direction, else in blotches."""
    height, threads = weave(rng, size)
    return height, threads if rng.random() < 0.5 else patches(rng, size)


def scratched(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    """A flat surface with straight grooves."""
    depth = np.zeros((size, size))
    centre = np.arange(size) - size / 2
    y, x = np.meshgrid(centre, centre, indexing="ij")
    for _ in range(int(rng.integers(5, 60))):
        angle, length, width = rng.uniform(0, np.pi), rng.uniform(0.1, 0.5) * size, rng.uniform(0.7, 2.0)
        along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        groove = np.exp(-np.square(across / width) - (along / length) ** 8)
        depth = np.maximum(depth, np.roll(groove, rng.integers(size, size=2), (0, 1)))
    return -depth, depth if rng.random() < 0.5 else patches(rng, size)


def cells(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    """Worley 1996: pebbles, hammer marks or leather, by the distances to scattered points."""
    cells = int(rng.integers(3, 25))
    points = np.stack(np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"), -1) + rng.random(
        (cells, cells, 2)
    )
    y, x = np.meshgrid((np.arange(size) + 0.5) / size * cells, (np.arange(size) + 0.5) / size * cells, indexing="ij")
    distances = []
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            row, column = np.floor(y).astype(np.int64) + dy, np.floor(x).astype(np.int64) + dx
            point = points[row % cells, column % cells]
            # A wrapped point lies whole periods away from its original.
            distances.append(
                np.hypot(point[..., 0] + row - row % cells - y, point[..., 1] + column - column % cells - x)
            )
    nearest, second = np.sort(np.stack(distances), 0)[:2]
    seam = step(second - nearest - rng.uniform(0.05, 0.2), rng.uniform(3, 15))
    height = np.square(nearest) if rng.random() < 0.5 else seam * (1 - np.square(nearest))
    return height, 1 - seam


def smooth(rng: np.random.Generator, size: int) -> tuple[Field, Field]:
    """Hardly any relief: painted, polished, plated."""
    return noise(rng, size, rng.uniform(0.005, 0.03)), patches(rng, size)


RELIEFS: tuple[Relief, ...] = (bumps, rock, brushed, tiles, woven, scratched, cells, smooth)
