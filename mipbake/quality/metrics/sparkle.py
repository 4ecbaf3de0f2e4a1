"""False sparkle: bright spots that the reference does not have."""

from __future__ import annotations

import numpy as np

from mipbake.quality.metrics.images import ImageArray, Measured, checked_display

THRESHOLD = 0.1
"""How much brighter than the reference a displayed value may be, in units of the displayed range."""


def false_sparkle(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean of max(0, P - R - THRESHOLD) over displayed, sRGB-encoded values: 0 is right, 0.9 the worst.

    It looks one way: what is too dark, and what is too bright by THRESHOLD or less, counts nothing. A dot that is
    brighter counts by how much it is, so few bright dots weigh as much as many faint ones. Each of the three channels
    is compared by itself, and a pixel has the mean of the three, so that red light where the reference has green counts
    as sparkle though both may have one luminance. Noise of the reference counts where it exceeds THRESHOLD.

    Args:
        candidate, reference: (..., 3) sRGB-encoded colours in [0, 1], one shape: pictures or whole films.

    Returns:
        The mean, and its map: the mean over the three channels at each pixel, of each frame.

    Raises:
        UsageError: other shapes or values.
    """
    p, r = checked_display(candidate, reference)
    per_pixel = np.maximum(p - r - THRESHOLD, 0).mean(-1)
    return Measured(float(per_pixel.mean()), per_pixel.astype(np.float32))
