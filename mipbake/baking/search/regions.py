"""Which texels are optimised together, and the part of a level that such a region sees.

Coarse levels come first, all together, then the fine ones one by one, in windows where they are large.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import material, sampling
from mipbake.baking.search.texel_coordinates import stored_adjoint, to_coordinates, to_stored
from mipbake.quality.reference.problem import Image, Problem, Region


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


def timed_regions(problem: Problem, window: int, coarse: int) -> Iterator[TimedRegion]:
    """All regions, the coarsest levels first.

    Args:
        window: texels a side; larger levels are worked on in windows that share no texel and leave none out.
        coarse: texels a side up to which levels are optimised together: they are seen from afar, and cost next to
            nothing.
    """
    sizes = problem.sizes
    first = sum(max(size) > coarse for size in sizes)
    yield TimedRegion(Region(0, 1, 0, 1, range(first, len(sizes))), float(coarse))
    for level in range(first - 1, -1, -1):
        height, width = sizes[level]
        rows, columns = -(-height // window), -(-width // window)
        top, left = (np.linspace(0, 1, count + 1).tolist() for count in (rows, columns))
        for i in range(rows):
            for j in range(columns):
                region = Region(top[i], top[i + 1], left[j], left[j + 1], range(level, level + 1))
                yield TimedRegion(region, math.sqrt(height * width) / (rows * columns))


def texels_between(low: float, high: float, size: int) -> slice:
    """The free texels along an axis of a level of so many texels, from one place to another in units of the texture.

    Rounded alike for neighbours: windows share no texel and leave none out.
    """
    return slice(round(low * size), round(high * size))


@dataclass
class Axis:
    """Where the free texels of a level lie along one axis, and what is around them.

    Args:
        size: texels of the level. first, last: of the free texels; last is not one of them.
        mode: what the level has beyond its ends. around: texels at both ends that are looked up as well.
    """

    size: int
    first: int
    last: int
    mode: str
    around: int

    @classmethod
    def of(cls, size: int, low: float, high: float, mode: str, around: int) -> Axis:
        texels = texels_between(low, high, size)
        return cls(size, texels.start, texels.stop, mode, around)

    @property
    def whole(self) -> bool:
        return self.last - self.first == self.size

    @property
    def index(self) -> NDArray[np.int64]:
        """Texels of the crop: the free ones, with a ring of more around them where the level goes on."""
        if self.whole:
            return np.arange(self.size)
        index = np.arange(self.first - self.around, self.last + self.around)
        return index % self.size if self.mode == "wrap" else np.clip(index, 0, self.size - 1)

    @property
    def inside(self) -> slice:
        """The free texels in the crop."""
        return slice(None) if self.whole else slice(self.around, -self.around)

    @property
    def boundary(self) -> str:
        return self.mode if self.whole else "clamp"

    def local(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates in units of the texture to coordinates in units of the crop."""
        ring = 0 if self.whole else self.around
        return np.asarray((u * self.size - self.first + ring) / (self.last - self.first + 2 * ring))

    def pixels(self) -> tuple[int, int]:
        """First and last cell of pixels that see free texels."""
        low, high = (self.first, self.last) if self.whole else (self.first - 1, self.last + 1)
        return (low, high) if self.mode == "wrap" else (max(low, 0), min(high, self.size))


class Crop:
    """The part of a level that a region sees, its free texels in `coordinates`.

    Past rounds leave (h, w, P, P) curvature to hold them, `held`, and (h, w, P) their `mean` over rounds; None before
    the first round.

    Args:
        level: (H, W, C) stored channels.
        free: whether its texels inside the region may move.
        around: texels around the region that are looked up as well, at least 4: pixels of a finer level read three.
    """

    def __init__(self, level: Image, region: Region, problem: Problem, free: bool, around: int) -> None:
        self.model, wrap = problem.target, problem.wrap
        self.columns = Axis.of(level.shape[1], region.left, region.right, wrap[0], around)
        self.rows = Axis.of(level.shape[0], region.top, region.bottom, wrap[1], around)
        self._around = np.ascontiguousarray(level[np.ix_(self.rows.index, self.columns.index)])
        self.free = free and self.rows.last > self.rows.first and self.columns.last > self.columns.first
        inside = self._around[self.rows.inside, self.columns.inside]
        self.coordinates = to_coordinates(inside, self.model)
        self.now: Image = self._around
        self.held: Image | None = None
        self.mean: Image | None = None
        self.boundary = self.columns.boundary, self.rows.boundary

    @property
    def window(self) -> tuple[slice, slice]:
        """The free texels in the level."""
        return slice(self.rows.first, self.rows.last), slice(self.columns.first, self.columns.last)

    def move(self, coordinates: Image) -> None:
        """Moves the free texels to (h, w, P) coordinates; those out of range stop at its end."""
        inside = to_stored(coordinates, self.model)
        self.coordinates = to_coordinates(inside, self.model)
        self.now = self._around.copy()
        self.now[self.rows.inside, self.columns.inside] = inside

    def gradient(self, by_texel: Image) -> Image:
        """(h, w, P) by the coordinates, from (h', w', C) by the stored channels of `now`."""
        return stored_adjoint(self.coordinates, by_texel[self.rows.inside, self.columns.inside], self.model)

    def values(self, coordinates: Image) -> Image:
        """(h, w, C) stored channels of coordinates of the free texels, unit vectors to the last digit."""
        return np.asarray(material.regularise(to_stored(coordinates, self.model), self.model), np.float32)

    def local(self, uv: NDArray[np.float64]) -> Image:
        """(P, 2) uv in units of the crop."""
        return np.stack([self.columns.local(uv[:, 0]), self.rows.local(uv[:, 1])], -1).astype(np.float32)

    def bilinear(self, uv: NDArray[np.float64]) -> Image:
        """(P, C): the level as it is now at (P, 2) uv, bilinearly."""
        where = self.local(uv)[None, None]
        return np.asarray(
            sampling.texture(self.now[None], where, filter_mode="linear", boundary_mode=self.boundary)[0, 0]
        )

    def pixels(self, least: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """(P, 2) uv: a random place in every texel that the region sees, several where there are few."""
        (top, bottom), (left, right) = self.rows.pixels(), self.columns.pixels()
        cells = np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), -1).reshape(-1, 2)
        cells = np.tile(cells, (-(-least // len(cells)), 1))
        return np.asarray((cells + rng.random(cells.shape)) / [self.columns.size, self.rows.size])
