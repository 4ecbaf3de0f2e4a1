"""The steps of latent_filter.py on tensors."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from mipbake.material.pixel_filter import Wrap
from mipbake.models.latent_filter import latent_weights


@lru_cache(maxsize=64)
def _matrix(n_in: int, n_out: int, latent_filter: str, wrap: str, first: bool, device: torch.device) -> Tensor:
    index, weights = latent_weights(n_in, n_out, latent_filter, wrap, first)
    matrix = np.zeros((n_out, n_in), np.float32)
    np.add.at(matrix, (np.arange(n_out)[:, None], index), weights)
    with torch.inference_mode(False):  # whoever asks first, training may ask later
        return torch.from_numpy(matrix).to(device)


def downsample(latent: Tensor, size: tuple[int, int], latent_filter: str, wrap: Wrap, first: bool) -> Tensor:
    """(B, H, W, Z) latents of a level to (B, size[0], size[1], Z) of the next; linear, differentiable."""
    batch, height, width, channels = latent.shape
    down_rows = _matrix(height, size[0], latent_filter, wrap[1], first, latent.device).to(latent)
    down_columns = _matrix(width, size[1], latent_filter, wrap[0], first, latent.device).to(latent)
    rows = torch.matmul(down_rows, latent.reshape(batch, height, width * channels))
    columns = torch.matmul(down_columns, rows.reshape(batch * size[0], width, channels))
    return columns.reshape(batch, *size, channels)
