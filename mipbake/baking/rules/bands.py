"""Images worked on some rows at a time: what a closed form averages never exists at full size."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.threads import on_threads

Array = NDArray[np.floating]
Image = NDArray[np.float32]

Texelwise = Callable[[Array], Array]
"""(rows, W, C) to (rows, W, D), texel by texel."""

CHUNK = 1 << 14
"""Texels worked on at a time: a dozen channels and their temporaries stay in the cache."""

BAND = 1 << 18
"""Texels of level 0 in a band."""

ROWS = 128
"""Rows of a band, at least: the filter reaches 16 rows beyond a band on either side, which are read twice."""


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


def chunks(image: Image) -> Iterator[tuple[Image, slice]]:
    """Some rows of an image each, as planes in memory, and which rows they are."""
    step = max(1, CHUNK // image.shape[1])
    for start in range(0, len(image), step):
        rows = slice(start, start + step)
        yield np.ascontiguousarray(image[rows].transpose(2, 0, 1)).transpose(1, 2, 0), rows
