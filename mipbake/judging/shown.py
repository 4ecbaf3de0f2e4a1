"""Small pictures of a level of detail, what is right in them, and how far from it a stack looks.

Single lights say most of the brightest pairs. What people look at is lit from everywhere, tonemapped, and seen by eyes
that care for some sizes of detail more than for others (mipbake.metrics.visible).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mipbake.metrics.images import display_slope, displayed
from mipbake.metrics.visible import SIDE, VisibleError, bands, masked, mean_squares
from mipbake.reference.problem import Image, Problem, Region, region_points
from mipbake.render.environment import ENVIRONMENTS, Lighting
from mipbake.render.small_pictures import (
    SLANTS,
    SmallPictures,
    draw_slants,
    draw_small_pictures,
    exposures,
)

Array = NDArray[np.float64]

KINDS_SHOWN = len(SLANTS)
"""Kinds of pictures, as `weights.SEEN` names them."""

_ROOMS = "studio", "sky", "lamps"  # that levels of detail have in turn; a guess
_LIGHTS = 16  # of a room that is a map: pictures are turned to it at random, so few stand for all; a guess
_FEWEST = 8  # pictures of a level of detail; a guess
_MOST_SAMPLES = 64  # of a pixel; a guess
_MAGNIFIED = 0.7  # levels of detail below 0 that count for level 0; a guess


@dataclass(frozen=True, eq=False)
class Shown:
    """Small pictures of a level of detail.

    Args:
        pictures: N of them, the same number of each kind, kind after kind.
        exposure: (N, 1, 1). right: (N, 3, SIDE, SIDE) bands of what is right. counts: what squared errors of bands
            count. noise: (V,) visible error of the noise of what is right.
    """

    pictures: SmallPictures
    exposure: Image
    right: Image
    counts: Image
    noise: Array

    def error(self, radiance: Image) -> VisibleError:
        """How far (N, PIXELS, 3) linear radiance looks from what is right."""
        return VisibleError(bands(displayed_pictures(radiance, self.exposure)) - self.right, self.counts, self.noise)

    def part(self, some: NDArray[np.intp]) -> Shown:
        """Some of the pictures, by their indices; what noise there is, is left to all of them."""
        pictures = self.pictures.part(some)
        return Shown(pictures, self.exposure[some], self.right[some], self.counts[some], self.noise)

    def slope(self, radiance: Image) -> Image:
        """(N, PIXELS, 3) derivatives of what is displayed by linear radiance."""
        return np.asarray(self.exposure * display_slope(radiance * self.exposure), np.float32)


def displayed_pictures(radiance: Image, exposure: Image) -> Image:
    """(N, SIDE, SIDE, 3) what a display shows of (N, PIXELS, 3) linear radiance."""
    return np.asarray(displayed(radiance * exposure), np.float32).reshape(-1, SIDE, SIDE, 3)


@lru_cache(maxsize=len(_ROOMS))
def _room(name: str) -> Lighting:
    return ENVIRONMENTS[name](_LIGHTS)


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
        lod: of the lookups. At level 0 pixels may also be smaller than texels. count: how many pictures there are.
        samples: of a pixel of level 0, in each of two estimates; twice as many at every second level.
    """
    count = max(_FEWEST, count // KINDS_SHOWN * KINDS_SHOWN)
    height, width = problem.sizes[0]
    centre = np.resize(region_points(problem, region, count, rng), (count, 2))
    lods = lod - (_MAGNIFIED if lod == 0 else 0.0) * rng.random(count)
    lighting = _room(_ROOMS[round(2 * lod) % len(_ROOMS)])
    pictures = draw_small_pictures(
        rng, lods, draw_slants(rng, count), (width, height), problem.sampler, lighting, centre
    )
    many = min(samples << int(lod + 1) // 2, max(samples, _MOST_SAMPLES))
    first, second = (pictures.reference(problem.filtered, many, rng) for _ in range(2))
    exposure = exposures((first + second) / np.float32(2))
    shown = displayed_pictures((first + second) / np.float32(2), exposure)
    apart = displayed_pictures(first, exposure) - displayed_pictures(second, exposure)
    right = bands(shown)
    counts = masked(right)
    return Shown(pictures, exposure, right, counts, mean_squares(bands(apart / np.float32(2)), counts, KINDS_SHOWN))
