"""Antialiased linear downsampling of latents: level L + 1 from level L, any size.

With a filter of variance s^2 (pixels^2), level L is to have s^2 4^L texels^2 in total, so each step to a level L adds
s^2 (4^L - 4^(L-1)): the kernel is narrower by sqrt(3/4). Where level 0 is not filtered, because the encoder sees to the
pixel filter there, the first step adds all of 4 s^2. The box composes by itself.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.pixel_filter import Wrap, resample_weights


def latent_weights(
    n_in: int, n_out: int, latent_filter: str, wrap: str, first: bool
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Source indices and weights, (n_out, taps) each, of one axis of a step; `first` from an unfiltered level 0."""
    if n_in == n_out:
        return np.arange(n_in)[:, None], np.ones((n_in, 1), np.float32)
    width = 1.0 if first or latent_filter == "box" else math.sqrt(0.75)
    return resample_weights(n_in, n_out, latent_filter, wrap, width)


@lru_cache(maxsize=64)
def _matrix(n_in: int, n_out: int, latent_filter: str, wrap: str, first: bool) -> Tensor:
    index, weights = latent_weights(n_in, n_out, latent_filter, wrap, first)
    matrix = np.zeros((n_out, n_in), np.float32)
    np.add.at(matrix, (np.arange(n_out)[:, None], index), weights)
    with torch.inference_mode(False):  # whoever asks first, training may ask later
        return torch.from_numpy(matrix)


def downsample(latent: Tensor, size: tuple[int, int], latent_filter: str, wrap: Wrap, first: bool) -> Tensor:
    """(B, H, W, Z) latents of a level to (B, size[0], size[1], Z) of the next; linear, differentiable."""
    batch, height, width, channels = latent.shape
    down_rows = _matrix(height, size[0], latent_filter, wrap[1], first).to(latent)
    down_columns = _matrix(width, size[1], latent_filter, wrap[0], first).to(latent)
    rows = torch.matmul(down_rows, latent.reshape(batch, height, width * channels))
    columns = torch.matmul(down_columns, rows.reshape(batch * size[0], width, channels))
    return columns.reshape(batch, *size, channels)
