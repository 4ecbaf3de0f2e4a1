"""What a fit asks of a renderer: it renders levels, and says where each pixel looked them up."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from mipbake.fitting.program import Frame

Array = NDArray[np.float32]
Tiles: TypeAlias = "NDArray[np.intp] | slice"
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
    """Few rectangles that hold the texels of all changed tiles (rows, columns) of a level of a size, and no others.

    Neighbours in a row of tiles are one rectangle, and so are equal runs of neighbours in rows below each other.
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
        """
        if known is None:
            return [[Rectangle(0, 0, *size)] for size in self.sizes]
        compared = zip(self.stamps, known, self.sizes, strict=True)
        return [rectangles(new != old, size) for new, old, size in compared]


def tiles_of(texels: NDArray[np.int32], sizes: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
    """(T,) numbers of the tiles that hold texels (K,), both increasing. Tiles are counted as texels are: level after
    level, of these (height, width)."""
    firsts, first_tiles = firsts_of(sizes), firsts_of(map(tiles_along, sizes))
    bounds = np.searchsorted(texels, firsts)
    found = []
    for level, size in enumerate(sizes):
        rows, columns = np.divmod(texels[bounds[level] : bounds[level + 1]] - firsts[level], size[1])
        own = rows // TILE * tiles_along(size)[1] + columns // TILE
        found.append(np.unique(own) + first_tiles[level])
    return np.concatenate(found).astype(np.intp)


class Stamps:
    """The stamps of a stack whose texels change from one call of a renderer to the next."""

    def __init__(self, sizes: Sequence[tuple[int, int]]) -> None:
        self._shapes = [tiles_along(size) for size in sizes]
        self._firsts = firsts_of(self._shapes)
        self._numbers = np.full(self._firsts[-1], new_stamp(), np.int64)

    def level(self, number: int) -> slice:
        """The tiles of a level."""
        return slice(self._firsts[number], self._firsts[number + 1])

    def touch(self, tiles: Tiles) -> None:
        """Gives these tiles a new number, because texels of them may be others from now on."""
        self._numbers[tiles] = new_stamp()

    def now(self) -> tuple[NDArray[np.int64], ...]:
        """Stamps for `Levels`, which stay as they are."""
        numbers = self._numbers.copy()
        numbers.flags.writeable = False
        parts = zip(pairwise(self._firsts), self._shapes, strict=True)
        return tuple(numbers[first:end].reshape(shape) for (first, end), shape in parts)


def firsts_of(sizes: Iterable[tuple[int, int]]) -> list[int]:
    """The number of the first part of each level, and of parts in all, where levels have (rows, columns) of parts."""
    return [int(n) for n in np.cumsum([0, *(rows * columns for rows, columns in sizes)])]


def write_bytes(texels: NDArray[np.uint8], values: Array) -> None:
    """Rounds values (H, W, C) to 8 bits, as files hold them, into the first channels of (H, W, C or more)."""
    for channel in range(values.shape[-1]):  # at a time, which NumPy is three times as quick at as at short vectors
        scaled = values[..., channel] * np.float32(255) + np.float32(0.5)
        texels[..., channel] = np.clip(scaled, 0, 255, out=scaled)  # the integer below


class Renderer(Protocol[V_contra]):
    """Anything that renders. It may be a game engine, or a few lines of Python.

    The same levels and the same view must give the same frame, as far as that is possible: a fit follows differences
    between frames.

    The attribute `called`, where a renderer has it, is what provenance calls the renderer. The method `close`, where a
    renderer has it, is called by `mipbake fit` at the end.
    """

    def render(self, levels: Levels, view: V_contra) -> Frame:
        """The frame of a view, with the maps looked up in `levels` as the engine looks its textures up."""
