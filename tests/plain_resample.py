"""Resampling in plain NumPy, tap after tap: the twin that the native kernel is compared with, bit for bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.material.pixel_filter import Taps

Image = NDArray[np.float32]


def plain_resample(image: Image, rows: Taps, columns: Taps) -> Image:
    """(H, W, C) to (h, w, C), as mipbake.material.pixel_filter.resample_taps."""
    combined = _along_rows(image, rows)
    return np.ascontiguousarray(_along_rows(combined.swapaxes(0, 1), columns).swapaxes(0, 1))


def _along_rows(image: Image, taps: Taps) -> Image:
    index, weights = taps
    if index.shape[1] == 1:
        return image[index[:, 0]]
    out = np.zeros((len(index), *image.shape[1:]), np.float32)
    for tap in range(index.shape[1]):
        out += image[index[:, tap]] * weights[:, tap, None, None]
    return out
