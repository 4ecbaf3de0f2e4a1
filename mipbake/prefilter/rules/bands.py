"""The levels of a closed form, made in bands of rows: what it averages never exists at full size.

A closed form turns texels into what it averages, averages that under the pixel filter at every level, and turns
averages into texels. The levels up to PRE_REDUCED are filtered from level 0 itself, and all of them come from one band
of level 0 while it lies in a cache. Coarser levels come from box averages, which the same band is reduced to. The bits
of a level hang neither on the bands nor on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mipbake import memory
from mipbake._threads import on_threads
from mipbake.pixel_filter import (
    PRE_REDUCED,
    Taps,
    Wrap,
    level_sizes,
    reduced_size,
    resample,
    resample_taps,
    resample_weights,
)
from mipbake.prefilter.base import Progress

Array = NDArray[np.floating]
Image = NDArray[np.float32]

Texelwise = Callable[[Array], Array]
"""(rows, W, C) to (rows, W, D), texel by texel."""

CHUNK = 1 << 14
"""Texels worked on at a time: a dozen channels and their temporaries stay in the cache. A guess."""

BAND = 1 << 18
"""Texels of level 0 in a band. A guess."""

ROWS = 128
"""Rows of a band, at least: the filter reaches 16 rows beyond a band on either side, which are read twice. A guess."""


def closed_form_levels(
    stored: Image, read: Texelwise | None, write: Texelwise, pixel_filter: str, wrap: Wrap, progress: Progress
) -> list[Image]:
    """Every level of a complete chain, (H_L, W_L, D), of (H, W, C) stored channels.

    Args:
        stored: C-contiguous.
        read: texels to what is averaged of them; None averages the texels as they are.
        write: averages to stored channels.
        pixel_filter, wrap: as in `mipbake.pixel_filter.filtered_levels`.
        progress: told the finished share, in this thread.
    """
    return _Levels(stored, read, write, pixel_filter, wrap).made(progress)


def texelwise(function: Texelwise, image: Image, out: Image | None = None) -> Image:
    """function(image), some rows at a time; `out`, which may be the image itself, is written to.

    The function is given planes, one for each channel: NumPy works on them several times faster than on texels.
    """
    for part, rows in chunks(image):
        made = function(part)
        if out is None:
            out = memory.empty((len(image), *made.shape[1:]))
        out[rows] = made
    assert out is not None
    return out


def texelwise_mean(function: Texelwise, image: Image) -> Image:
    """(D,) mean over all texels of function(image); the sums are in float64."""
    rows = max(1, BAND // image.shape[1])
    count = -(-len(image) // rows)

    def summed(index: int) -> NDArray[np.float64]:
        parts = (function(part) for part, _ in chunks(image[index * rows : (index + 1) * rows]))
        return np.asarray(np.sum([part.sum((0, 1), dtype=np.float64) for part in parts], 0))

    total = np.sum(on_threads(summed, count), 0)
    return np.asarray(total / (image.shape[0] * image.shape[1]), np.float32)


class _Levels:
    """What all bands share; see `closed_form_levels`."""

    def __init__(self, stored: Image, read: Texelwise | None, write: Texelwise, pixel_filter: str, wrap: Wrap) -> None:
        self._stored, self._read, self._write = stored, read, write
        self._filter, self._wrap = pixel_filter, wrap
        height, width = stored.shape[:2]
        self._sizes = level_sizes(height, width)
        self._direct = self._sizes[: PRE_REDUCED + 1]
        self._axes = [self._taps(size, pixel_filter) for size in self._direct]
        first = stored[:1, :1] if read is None else read(stored[:1, :1])
        channels = write(np.asarray(first, np.float32)).shape[-1]
        self._made = [memory.empty((*size, channels)) for size in self._direct]
        self._reduced: Image | None = None
        if len(self._sizes) > len(self._direct):
            size = reduced_size(self._sizes, len(self._direct), wrap)
            self._reduced = memory.empty((*size, first.shape[-1]))
            self._axes.append(self._taps(size, "box"))
        self._bands = max(1, height // max(ROWS, BAND // width))

    def made(self, progress: Progress) -> list[Image]:
        """The levels. `progress`: told the finished share; all but a few hundredths of the work are the bands."""
        on_threads(self._band, self._bands, progress)
        levels, finer = self._made, self._reduced
        for level in range(len(levels), len(self._sizes)):
            assert finer is not None
            if level > len(self._direct):
                finer = resample(finer, reduced_size(self._sizes, level, self._wrap), "box", self._wrap)
            averages = resample(finer, self._sizes[level], self._filter, self._wrap)
            levels.append(texelwise(self._write, averages))
        progress(1.0)
        return levels

    def _taps(self, size: tuple[int, int], pixel_filter: str) -> tuple[Taps, Taps]:
        """Of rows and of columns, from level 0 to a size."""
        rows, columns = (
            resample_weights(self._stored.shape[axis], size[axis], pixel_filter, self._wrap[1 - axis])
            for axis in (0, 1)
        )
        return rows, columns

    def _band(self, index: int) -> None:
        """Makes the rows of one band, of all levels that are filtered from level 0, and of what the others are."""
        parts = []
        for rows, columns in self._axes:
            here = slice(*(len(rows[0]) * end // self._bands for end in (index, index + 1)))
            parts.append((here, (rows[0][here], rows[1][here]), columns))
        band, first = self._texels(np.unique(np.concatenate([rows[0].ravel() for _, rows, _ in parts])))
        for level, (here, (at, weights), columns) in enumerate(parts):
            if not len(at):
                continue
            averages = resample_taps(band, (first[at], weights), columns)
            if level < len(self._made):
                texelwise(self._write, averages, self._made[level][here])
            elif self._reduced is not None:
                self._reduced[here] = averages

    def _texels(self, rows: NDArray[np.int64]) -> tuple[Image, NDArray[np.int64]]:
        """Those rows of what is averaged, and where each row of level 0 lies in it."""
        place = np.arange(len(self._stored))
        if self._read is None:
            return self._stored, place
        place[rows] = np.arange(len(rows))
        ends = np.nonzero(np.diff(rows, prepend=-2, append=np.iinfo(np.int64).max) != 1)[0]
        band: Image | None = None
        for start, end in pairwise(ends):  # rows that lie one below the other
            part = self._stored[rows[start] : rows[start] + end - start]
            if band is None and end - start == len(rows):
                return texelwise(self._read, part), place
            made = texelwise(self._read, part)
            band = np.empty((len(rows), *made.shape[1:]), np.float32) if band is None else band
            band[start:end] = made
        assert band is not None
        return band, place


def chunks(image: Image) -> Iterator[tuple[Image, slice]]:
    """Some rows of an image each, as planes in memory, and which rows they are."""
    step = max(1, CHUNK // image.shape[1])
    for start in range(0, len(image), step):
        rows = slice(start, start + step)
        yield np.ascontiguousarray(image[rows].transpose(2, 0, 1)).transpose(1, 2, 0), rows
