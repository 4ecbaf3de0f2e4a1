"""Antialiased linear downsampling of latents: level L + 1 from level L, any size; without torch.

With a filter of variance s^2 (pixels^2), level L is to have s^2 4^L texels^2 in total, so each step to a level L adds
s^2 (4^L - 4^(L-1)): the kernel is narrower by sqrt(3/4). Where level 0 is not filtered, because the encoder sees to the
pixel filter there, the first step adds all of 4 s^2. The box composes by itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mipbake.material.pixel_filter import resample_weights


def latent_weights(
    n_in: int, n_out: int, latent_filter: str, wrap: str, first: bool
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Source indices and weights, (n_out, taps) each, of one axis of a step; `first` from an unfiltered level 0."""
    if n_in == n_out:
        return np.arange(n_in)[:, None], np.ones((n_in, 1), np.float32)
    width = 1.0 if first or latent_filter == "box" else math.sqrt(0.75)
    return resample_weights(n_in, n_out, latent_filter, wrap, width)
