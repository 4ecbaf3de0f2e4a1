"""Tonemapped error: how far apart two radiances look once bright values are compressed."""

from __future__ import annotations

import numpy as np

from mipbake.quality.metrics.images import ImageArray, Measured, checked_radiance, displayed


def tonemapped_error(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean |s(p / (1 + p)) - s(r / (1 + r))| over colours and pixels, s the sRGB encoding: 0 is right, 1 the worst.

    x / (1 + x) is the global operator of Reinhard et al. 2002 ("Photographic tone reproduction for digital images",
    equation 3), by channel; s is IEC 61966-2-1. The reference's noise counts as error.

    Args:
        candidate, reference: (..., 3) linear radiance, one shape, from 0 up.

    Returns:
        The mean, and its map: the mean over the three colours at each pixel.

    Raises:
        UsageError: other shapes, or values that are negative or not finite.
    """
    p, r = checked_radiance(candidate, reference)
    per_pixel = np.abs(displayed(p) - displayed(r)).mean(-1)
    return Measured(float(per_pixel.mean()), per_pixel.astype(np.float32))
