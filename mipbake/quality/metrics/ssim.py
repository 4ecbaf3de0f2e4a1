"""SSIM: structural similarity, through scikit-image."""

from __future__ import annotations

import numpy as np

from mipbake.base.extras import extra
from mipbake.quality.metrics.images import ImageArray, Measured, check_picture, checked_display

WINDOW = 11
"""Pixels a side of the Gaussian window; smaller images have no SSIM."""


def structural_similarity(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean SSIM of what a display shows: 1 for the same image, at least -1. Symmetric in its images.

    Wang et al. 2004, "Image quality assessment: from error visibility to structural similarity", equation 13, with that
    paper's settings: Gaussian window of 11 x 11 pixels and sigma 1.5, K1 = 0.01, K2 = 0.03, range 1; by colour channel,
    averaged. The mean leaves out the 5 pixels at each border, where the window would leave the image; the map has them.

    Args:
        candidate, reference: (H, W, 3) sRGB-encoded colours in [0, 1], H and W at least 11.

    Raises:
        UsageError: other shapes or values, or scikit-image missing.
    """
    with extra("compare", "SSIM"):
        from skimage import metrics

    p, r = checked_display(candidate, reference)
    check_picture(r, WINDOW)
    mean, values = metrics.structural_similarity(
        r, p, data_range=1, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    return Measured(float(mean), np.asarray(values.mean(-1), np.float32))
