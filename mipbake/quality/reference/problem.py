"""What a stack is made for, and parts of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.quality.reference.sequences import random_points

Image = NDArray[np.float32]

_PIXELS_A_TEXEL, _LEAST_POINTS = 4, 128  # points of a region: so many for each texel, and no fewer than


@dataclass(frozen=True)
class Problem:
    """What a stack is optimised for.

    Args:
        stored: (H, W, C) stored channels of level 0 of the source, model `source`.
        target: material model of the stack.
        sampler: that will look the stack up.
    """

    stored: Image
    source: str
    target: str
    pixel_filter: str
    wrap: Wrap
    sampler: Sampler = DEFAULT_SAMPLER

    @property
    def thinned(self) -> int:
        """By how many times fewer points are looked at where frames are averaged.

        Each point is looked up and shaded in every frame. What is measured hangs on which lights and surfaces are drawn
        far more than on how many points see them, so half of what frames cost is taken from the points. Not tuned.
        """
        return max(1, self.sampler.frames // 2)

    @property
    def filtered(self) -> FilteredSource:
        """What the reference is estimated of."""
        return FilteredSource(self.stored, self.source, self.wrap, self.pixel_filter)

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of every level."""
        return level_sizes(*self.stored.shape[:2])

    def square_pixels(self, lods: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 2, 2) axes of pixels that cover (...) levels of detail, in units of the texture."""
        height, width = self.sizes[0]
        return np.asarray(np.exp2(lods)[..., None, None] * np.diag([1 / width, 1 / height]))

    @property
    def last(self) -> int:
        """Index of the coarsest level."""
        return len(self.sizes) - 1


@dataclass(frozen=True)
class Region:
    """Part of the texture in units of it, and the levels that are worked on there."""

    top: float
    bottom: float
    left: float
    right: float
    levels: range

    @property
    def origin(self) -> NDArray[np.float64]:
        """(2,) u and v of the corner."""
        return np.array([self.left, self.top])

    @property
    def extent(self) -> NDArray[np.float64]:
        """(2,) width and height."""
        return np.array([self.right - self.left, self.bottom - self.top])


def whole(problem: Problem) -> Region:
    """All of the texture and all of its levels."""
    return Region(0, 1, 0, 1, range(problem.last + 1))


def covered(problem: Problem, lods: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Levels of detail that pixels cover which are looked up at these: without the MIP bias.

    Where the bias is negative, level 0 is looked up by all pixels up to one that the bias brings there: they are drawn
    evenly from there down to pixels as wide as a texel.
    """
    bias = problem.sampler.bias
    if not bias:
        return lods
    at_first = np.where(lods <= 0, rng.random(np.shape(lods)), 1.0)
    return np.asarray(lods - bias * (at_first if bias < 0 else 1.0))


def region_points(problem: Problem, region: Region, most: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(P, 2) uv inside a region, at most so many; regions of few texels of level 0 need few."""
    height, width = problem.sizes[0]
    texels = math.ceil(height * width * region.extent.prod())
    count = max(1, min(most, max(_PIXELS_A_TEXEL * texels, _LEAST_POINTS)))
    return np.asarray(region.origin + random_points(rng, count) * region.extent)
