"""What a fit asks of a renderer: it renders levels, and says where each pixel looked them up."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
V_contra = TypeVar("V_contra", contravariant=True)


TILE = 64
"""Texels along a side of a tile. Smaller tiles fit what a view shows more closely, and ask more calls of a driver."""

_STAMPS = itertools.count(1)


def new_stamp() -> int:
    """A number that no tile of this process has been given yet. It is above all numbers before it."""
    return next(_STAMPS)


def tiles_along(size: tuple[int, int]) -> tuple[int, int]:
    """(rows, columns) of the tiles of a level that measures (height, width) texels."""
    return -(-size[0] // TILE), -(-size[1] // TILE)


def new_stamps(sizes: Sequence[tuple[int, int]]) -> tuple[NDArray[np.int64], ...]:
    """Stamps of levels of these (height, width), all of whose tiles get one new number."""
    stamp = new_stamp()
    return tuple(np.full(tiles_along(size), stamp, np.int64) for size in sizes)


class Rectangle(NamedTuple):
    """So many rows of texels from `row` on, and so many columns from `column` on."""

    row: int
    column: int
    height: int
    width: int

    def of(self, array: NDArray[Any]) -> NDArray[Any]:
        """These texels of an array (H, W, ...), as a view of it."""
        return array[self.row : self.row + self.height, self.column : self.column + self.width]


def rectangles(changed: NDArray[np.bool_], size: tuple[int, int]) -> list[Rectangle]:
    """Few rectangles that hold the texels of all changed tiles, and no others; a whole level is one rectangle.

    Neighbours in a row of tiles are one rectangle, and so are equal runs of neighbours in rows below each other.

    Args:
        changed: (rows, columns) of tiles, as `tiles_along` counts them.
        size: (height, width) of the level in texels. Tiles at the lower and the right edge may be smaller than others.
    """
    found: list[list[int]] = []  # in tiles: the first row, the row below the last, and the same of columns
    newest: dict[tuple[int, int], list[int]] = {}
    # A run begins where the row changes from unchanged to changed, and ends where it changes back.
    borders = np.argwhere(np.diff(np.pad(changed, ((0, 0), (1, 1))), axis=1))
    for (row, first), (_, end) in borders.reshape(-1, 2, 2).tolist():
        above = newest.get((first, end))
        if above is not None and above[1] == row:
            above[1] = row + 1
        else:
            newest[first, end] = [row, row + 1, first, end]
            found.append(newest[first, end])
    return [
        Rectangle(top, left, min(TILE * below, size[0]) - top, min(TILE * beside, size[1]) - left)
        for top, below, left, beside in ((TILE * a, b, TILE * c, d) for a, b, c, d in found)
    ]


@dataclass(frozen=True, eq=False)
class Levels:
    """A MIP stack as a renderer gets it: what files of 8 bits would hold, before they are rounded.

    Args:
        model: a name in `mipbake.material.MODELS`.
        maps: name of each map of the model to its levels, finest first: (H_L, W_L, channels) float32. Colours are
            sRGB-encoded from 0 to 1, vectors are (x + 1) / 2, roughness, metallic and strength are as they are.
            Logarithms (of `ggx` and `beckmann`) are as they are, too. The arrays may be views. They cannot be written
            to, and change after the call.
        wrap: addressing along u and v, each "wrap" or "clamp".
        stamps: for each level a number for each of its tiles, (ceil(H_L / 64), ceil(W_L / 64)) int64. A tile is a
            square of 64 x 64 texels, from the first row and column on; those at the other edges may be smaller. A tile
            has another number whenever any of its texels are others, and numbers only grow as texels change. They do
            not change after the call. A renderer that keeps textures uploads what `changed` gives.
    """

    model: str
    maps: Mapping[str, Sequence[Array]]
    wrap: tuple[str, str]
    stamps: tuple[NDArray[np.int64], ...]

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of each level."""
        first = next(iter(self.maps.values()))
        return [(level.shape[0], level.shape[1]) for level in first]

    def changed(self, known: Sequence[NDArray[np.int64]] | None) -> list[list[Rectangle]]:
        """What a renderer has to upload: for each level few rectangles of texels.

        Args:
            known: the `stamps` of the levels that the renderer has, of the same sizes; None where it has none.

        Returns:
            The tiles whose numbers are others than the known ones; all texels where none are known.
        """
        if known is None:
            return [[Rectangle(0, 0, *size)] for size in self.sizes]
        compared = zip(self.stamps, known, self.sizes, strict=True)
        return [rectangles(new != old, size) for new, old, size in compared]


@dataclass(frozen=True, eq=False)
class Frame:
    """What a renderer made of a view, rows from the top.

    Args:
        image: (H, W, 3), linear radiance; or what a display gets, for fits that compare it as it is.
        uv: (H, W, 2) where the pixel's centre looked the maps up; u to the right and v down, any real numbers where
            the maps repeat.
        lod: (H, W) level of detail of a trilinear lookup; or None, then `uv_da` is given.
        uv_da: (H, W, 4) du/dX, du/dY, dv/dX, dv/dY per pixel, of an anisotropic lookup with up to 16 samples along the
            footprint; or None.
        id: (H, W) integers from 0 on, 0 where a pixel shows nothing of the maps. None: every pixel shows them.

    Any array of numbers will do, and the renderer may use it again for the next frame. A fit checks shapes, and that
    values are finite.
    """

    image: Any
    uv: Any
    lod: Any = None
    uv_da: Any = None
    id: Any = None


class Renderer(Protocol[V_contra]):
    """Anything that renders. It may be a game engine, or a few lines of Python.

    The same levels and the same view must give the same frame, as far as that is possible: a fit follows differences
    between frames.

    The attribute `called`, where a renderer has it, is what provenance calls the renderer. Three more methods are used
    where a renderer has them:

    - `image(levels, view)` gives the image of a frame alone, without what does not change with the maps.
    - `summed(levels, views, weights)` gives the sum of weights times images, (H, W, 3), and at each pixel the sum of
      the weights of the views in which it shows the maps, (H, W). Pixels that show something else are 0 in images here.
      The views are one view, moved by parts of a pixel. A weight is a number of any sign. References are made by it,
      from 16 to 1024 renders each.
    - `close()` is called by `mipbake fit` at the end.
    """

    def render(self, levels: Levels, view: V_contra) -> Frame:
        """The frame of a view, with the maps looked up in `levels` as the engine looks its textures up."""
