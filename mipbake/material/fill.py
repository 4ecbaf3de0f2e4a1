"""Filling what does not count from its surroundings, coarse to fine.

Holes between texture tiles, and the colours that a mask hides, must not bleed into what is filtered beside them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.material.pixel_filter import Wrap

Array = NDArray[np.float32]


def fill(values: Array, weights: NDArray[np.floating], wrap: Wrap = ("clamp", "clamp")) -> Array:
    """Values where the weight is 1, smooth continuations of them where it is 0: pull and push.

    Pull: every coarser level averages four values by their weights, and counts for as much as those do together, up to
    1. Push: what a level lacks comes from the next coarser one, interpolated bilinearly (Gortler et al. 1996, The
    Lumigraph, section 3.4). Vectors come out shorter than one between others: normalise them afterwards.

    Args:
        values: (H, W, C). Those of weight 0 are never used, whatever they are, NaN included.
        weights: (H, W) in [0, 1]; a weight in between mixes the value with its surroundings by that share.
        wrap: addressing along u and v, each "wrap" or "clamp".

    Returns:
        (H, W, C), a new array: bit for bit the value where the weight is 1; within the range of the values that count
        everywhere. A copy of the values where no weight is above 0.
    """
    weight = np.clip(np.asarray(weights, np.float32), 0, 1)[..., None]
    if not weight.any():
        return np.array(values, np.float32)
    finest = np.where(weight > 0, values, 0).astype(np.float32, copy=False)
    levels = [(finest, weight)]
    while levels[-1][1].min() < 1 and max(levels[-1][0].shape[:2]) > 1:
        levels.append(_pulled(*levels[-1]))
    # The last level is complete, or a single texel: the average of all that counts.
    filled = levels.pop()[0]
    for finer, share in reversed(levels):
        surroundings = _doubled(_doubled(filled, 0, finer.shape[0], wrap[1]), 1, finer.shape[1], wrap[0])
        filled = share * finer + (1 - share) * surroundings
    return np.asarray(filled, np.float32)


def _pulled(values: Array, weight: Array) -> tuple[Array, Array]:
    """Weighted averages of 2 x 2 texels (H, W, C) and their weight (H, W, 1); sizes are rounded up."""
    height, width = ((size + 1) // 2 for size in values.shape[:2])
    total = _summed(weight, height, width)
    average = _summed(values * weight, height, width) / np.maximum(total, np.finfo(np.float32).tiny)
    return average, np.minimum(total, 1)


def _summed(image: Array, height: int, width: int) -> Array:
    missing = [(0, 2 * size - have) for size, have in zip((height, width), image.shape[:2], strict=True)]
    even = np.pad(image, [*missing, (0, 0)])
    return np.asarray(even.reshape(height, 2, width, 2, -1).sum((1, 3)), np.float32)


def _doubled(coarse: Array, axis: int, size: int, mode: str) -> Array:
    """Bilinear from texels twice as large, along one axis, cut to `size`."""
    count = coarse.shape[axis]
    at = np.arange(size)
    other = at // 2 + np.where(at % 2, 1, -1)
    other = other % count if mode == "wrap" else np.clip(other, 0, count - 1)
    near, far = np.take(coarse, at // 2, axis), np.take(coarse, other, axis)
    return np.asarray(near + np.float32(0.25) * (far - near), np.float32)
