"""Which texels are optimised together: coarse levels first, then the fine ones one by one, in windows where they are
large."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mipbake.baking.search.crops import texels_between
from mipbake.quality.reference.problem import Problem, Region

COARSE = 128
"""Texels a side up to which levels are optimised together: they are seen from afar, and cost next to nothing."""


@dataclass(frozen=True)
class TimedRegion:
    """A region that is optimised at once, and its share of the time.

    Args:
        region: the texels and levels that are optimised, all else held.
        share: of the time, in proportion to the other regions: gains fall off with time spent, so it grows with the
            root of the texels.
    """

    region: Region
    share: float


def window(region: Region, size: tuple[int, int]) -> tuple[slice, slice]:
    """The texels of a region in a level of a size (height, width): rows and columns."""
    height, width = size
    return texels_between(region.top, region.bottom, height), texels_between(region.left, region.right, width)


def timed_regions(problem: Problem, window: int, fine: bool, coarse: int = COARSE) -> Iterator[TimedRegion]:
    """All regions, the coarsest levels first.

    Args:
        window: texels a side; larger levels are worked on in windows that share no texel and leave none out.
        fine: whether levels larger than `coarse` texels a side take part.
    """
    sizes = problem.sizes
    first = sum(max(size) > coarse for size in sizes)
    yield TimedRegion(Region(0, 1, 0, 1, range(first, len(sizes))), float(coarse))
    for level in range(first - 1, -1, -1) if fine else ():
        height, width = sizes[level]
        rows, columns = -(-height // window), -(-width // window)
        top, left = (np.linspace(0, 1, count + 1).tolist() for count in (rows, columns))
        for i in range(rows):
            for j in range(columns):
                region = Region(top[i], top[i + 1], left[j], left[j + 1], range(level, level + 1))
                yield TimedRegion(region, math.sqrt(height * width) / (rows * columns))
