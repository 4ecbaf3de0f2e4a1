"""Small pictures of a level of detail, what is right in them, and how far from it a stack looks.

Single lights say most of the brightest pairs. What people look at is lit from everywhere, tonemapped, and seen by eyes
that care for some sizes of detail more than for others (mipbake.quality.metrics.visible).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.environment import Lighting, lighting_named
from mipbake.quality.metrics.images import tonemap_slope, tonemapped
from mipbake.quality.metrics.visible import SIDE, VisibleError, adaptation, bands, mean_squares
from mipbake.quality.reference.problem import Image, Problem, Region, region_points
from mipbake.quality.small_pictures import SLANTS, SmallPictures, draw_slants, draw_small_pictures, exposures

Array = NDArray[np.float64]

KINDS_SHOWN = len(SLANTS)
"""Kinds of pictures: as many as there are terms of `VISIBLE` (terms.py), in their order."""

_ROOMS = "studio", "sky", "lamps"  # that pictures are in by turns
_FEWEST = 4 * KINDS_SHOWN  # pictures of a level of detail
_MOST_SAMPLES = 16  # of a pixel
_MAGNIFIED = 0.7  # levels of detail below 0 that count for level 0


@dataclass(frozen=True, eq=False)
class Shown:
    """Small pictures of a level of detail.

    Args:
        pictures: N of them, the same number of each kind, kind after kind.
        exposure: (N, 1, 1). adapted: (N, 1, 1) light that eyes are adapted to.
        right: (N, 3, SIDE, SIDE) bands of what is right. noise: (N,) mean squares of its noise.
        kinds: V.
    """

    pictures: SmallPictures
    exposure: Image
    adapted: Image
    right: Image
    noise: Array
    kinds: int = KINDS_SHOWN

    def error(self, radiance: Image) -> VisibleError:
        """How far (N, PIXELS, 3) linear radiance looks from what is right."""
        return VisibleError(_bands(radiance, self.exposure, self.adapted) - self.right, self.noise, self.kinds)

    def part(self, some: NDArray[np.intp]) -> Shown:
        """Some of the pictures, by their indices, as one kind."""
        pictures = self.pictures.part(some)
        return Shown(pictures, self.exposure[some], self.adapted[some], self.right[some], self.noise[some], 1)

    def slope(self, radiance: Image) -> Image:
        """(N, PIXELS, 3) derivatives of contrasts, as `mipbake.quality.metrics.visible` has them, by linear
        radiance."""
        return np.asarray(self.exposure / self.adapted * tonemap_slope(radiance * self.exposure), np.float32)


@lru_cache(maxsize=1)
def _rooms() -> tuple[Lighting, ...]:
    return tuple(lighting_named(name) for name in _ROOMS)


def draw_shown(
    problem: Problem,
    region: Region,
    lod: float,
    count: int,
    samples: int,
    rng: np.random.Generator,
) -> Shown:
    """Small pictures of a level of detail in a region, at least a few of each kind.

    Args:
        lod: of the lookups, MIP bias included. Pixels that are smaller than texels look level 0 up as well, and where
            the bias is negative some that are larger. count: how many pictures there are; half as many where frames are
            averaged.
        samples: of a pixel of level 0, in each of two estimates; twice as many at every second level, to four times as
            many.
    """
    # What frames cost more is saved in part by fewer pictures.
    count = max(_FEWEST, count // math.isqrt(problem.sampler.frames) // KINDS_SHOWN * KINDS_SHOWN)
    height, width = problem.sizes[0]
    centre = np.resize(region_points(problem, region, count, rng), (count, 2))
    sampler = problem.sampler
    lods = lod - (max(_MAGNIFIED - sampler.bias, 0.0) if lod == 0 else 0.0) * rng.random(count)
    pictures = draw_small_pictures(rng, lods, draw_slants(rng, count), (width, height), sampler, _rooms(), centre)
    many = min(samples << max(0, int(lod - sampler.bias + 1)) // 2, max(samples, min(4 * samples, _MOST_SAMPLES)))
    first, second = (pictures.reference(problem.filtered, many, rng) for _ in range(2))
    both = (first + second) / np.float32(2)
    exposure = exposures(both)
    adapted = adaptation(tonemapped(both * exposure))[..., 0]
    right, *estimates = (_bands(each, exposure, adapted) for each in (both, first, second))
    noise = mean_squares((estimates[0] - estimates[1]) / np.float32(2))
    return Shown(pictures, exposure, adapted, right, noise)


def _bands(radiance: Image, exposure: Image, adapted: Image) -> Image:
    return bands((tonemapped(radiance * exposure) / adapted).reshape(-1, SIDE, SIDE, 3))
