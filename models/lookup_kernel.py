"""The filters of level_filter.py on tensors: levels of images that repeat, for training, and sharpening."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import level_sizes, resample_weights
from mipbake.models.level_filter import sharpening, width_of


def sharpened(image: Tensor, level: int, wrap: tuple[str, str]) -> Tensor:
    """(..., H, W, C) filtered with (-a, 1 + 2 a, -a) along both axes; an axis of one texel stays as it is."""
    a = sharpening(level)
    for axis, mode in ((image.ndim - 3, wrap[1]), (image.ndim - 2, wrap[0])):
        size = image.shape[axis]
        if size > 1:
            index = torch.arange(size, device=image.device)
            before, after = index - 1, index + 1
            if mode == "wrap":
                before, after = before % size, after % size
            else:
                before, after = before.clamp(min=0), after.clamp(max=size - 1)
            sides = image.index_select(axis, before) + image.index_select(axis, after)
            image = (1 + 2 * a) * image - a * sides
    return image


@lru_cache(maxsize=256)
def periodic_matrices(
    size: int, pixel_filter: str, sharp: bool, sampler: Sampler | None, device: torch.device
) -> tuple[Tensor, ...]:
    """(size_L, size) of every level of a square image that repeats: pixel filter and, if `sharp`, sharpening in one.

    `sampler`: that will look the levels up; None where the network does not take it.
    """
    out = []
    for level, (side, _) in enumerate(level_sizes(size, size)):
        width = 1.0 if sampler is None else width_of(level, sampler)
        index, weights = resample_weights(size, side, pixel_filter, "wrap", width)
        matrix = np.zeros((side, size))
        np.add.at(matrix, (np.arange(side)[:, None], index), weights)
        if sharp and side > 1:
            a = sharpening(level)
            matrix = (1 + 2 * a) * matrix - a * (np.roll(matrix, 1, 0) + np.roll(matrix, -1, 0))
        with torch.inference_mode(False):  # whoever asks first, training may ask later
            out.append(torch.from_numpy(matrix.astype(np.float32)).to(device))
    return tuple(out)


def periodic_levels(
    image: Tensor, pixel_filter: str, sharp: bool = True, sampler: Sampler | None = None
) -> list[Tensor]:
    """(B, S, S, C) images that repeat to (B, S_L^2, C) of every level; linear, differentiable."""
    batch, size, _, channels = image.shape
    matrices = [each.to(image) for each in periodic_matrices(size, pixel_filter, sharp, sampler, image.device)]
    rows = torch.matmul(torch.cat(matrices), image.reshape(batch, size, size * channels))
    rows = rows.reshape(batch, -1, size, channels)
    parts = torch.split(rows, [len(matrix) for matrix in matrices], 1)
    return [torch.matmul(m, part).flatten(1, 2) for m, part in zip(matrices, parts, strict=True)]
