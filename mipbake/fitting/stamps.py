"""Which tiles of a stack are others than when its renderer last got it.

Tiles have numbers: level after level from the finest on, row after row, as texels have.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mipbake.fitting.renderer import TILE, new_stamp, tiles_along


def tiles_of(texels: NDArray[np.int32], sizes: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
    """(T,) numbers of the tiles that hold texels, increasing.

    Args:
        texels: (K,) numbers of texels, increasing.
        sizes: (height, width) of each level in texels, finest first.
    """
    firsts = _firsts(sizes)
    first_tiles = _firsts(map(tiles_along, sizes))
    bounds = np.searchsorted(texels, firsts)
    found = []
    for level, size in enumerate(sizes):
        rows, columns = np.divmod(texels[bounds[level] : bounds[level + 1]] - firsts[level], size[1])
        own = rows // TILE * tiles_along(size)[1] + columns // TILE
        found.append(np.unique(own) + first_tiles[level])
    return np.concatenate(found).astype(np.intp)


class Stamps:
    """The stamps of a stack whose texels change from one call of a renderer to the next.

    Args:
        sizes: (height, width) of each level in texels, finest first.
    """

    def __init__(self, sizes: Sequence[tuple[int, int]]) -> None:
        self._shapes = [tiles_along(size) for size in sizes]
        self._firsts = _firsts(self._shapes)
        self._numbers = np.zeros(self._firsts[-1], np.int64)
        self._touched = np.ones(self._firsts[-1], np.bool_)

    def touch(self, tiles: NDArray[np.intp]) -> None:
        """Says that texels of these tiles may be others than at the last `handed_out`."""
        self._touched[tiles] = True

    def touch_all(self, level: int | None = None) -> None:
        """Says so of all tiles of a level; None: of all levels."""
        first, end = (0, -1) if level is None else (level, level + 1)
        self._touched[self._firsts[first] : self._firsts[end]] = True

    def handed_out(self) -> tuple[NDArray[np.int64], ...]:
        """Stamps for `Levels`: a new number for the tiles that were touched since the last call, and for no others.

        The arrays stay as they are.
        """
        self._numbers[self._touched] = new_stamp()
        self._touched[...] = False
        numbers = self._numbers.copy()
        numbers.flags.writeable = False
        parts = zip(pairwise(self._firsts), self._shapes, strict=True)
        return tuple(numbers[first:end].reshape(shape) for (first, end), shape in parts)


def _firsts(sizes: Iterable[tuple[int, int]]) -> list[int]:
    """The number of the first part of each level, and of parts in all, where levels have (rows, columns) of parts."""
    return [int(n) for n in np.cumsum([0, *(rows * columns for rows, columns in sizes)])]
