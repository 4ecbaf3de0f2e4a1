"""Images that are worked on tile by tile: what lies around a tile, and what a tile adds to a coarser image.

Downsampling is linear, so each tile adds its part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.material.pixel_filter import Wrap

DEFAULT_TILE = 128
"""Texels on a tile's side: with its halo, what the encoder holds of it stays within a core's share of the cache."""

CARD_TILE = 512
"""The same on a graphics card, which small tiles keep waiting for the next call; 1 or 2 GB are held of it."""


def tile_for(device: torch.device) -> int:
    """Texels on a tile's side that suit a device."""
    return DEFAULT_TILE if device.type == "cpu" else CARD_TILE


@dataclass(frozen=True)
class Piece:
    """Tile of one axis, and what it adds to a coarser level: rows[i] += weights[i, j] texel[start + j]."""

    start: int
    stop: int
    rows: Tensor
    weights: Tensor


def pieces(
    index: NDArray[np.int64], weights: NDArray[np.float32], n_in: int, tile: int, device: torch.device
) -> list[Piece]:
    """The tiles of an axis of n_in texels, whose coarser level takes (n_out, taps) source texels with their weights.

    Their tensors lie on the device.
    """
    found = []
    for start in range(0, n_in, tile):
        stop = min(start + tile, n_in)
        inside = (index >= start) & (index < stop)
        rows = np.flatnonzero(inside.any(1))
        matrix = np.zeros((len(rows), stop - start), np.float32)
        output, tap = np.nonzero(inside[rows])
        np.add.at(matrix, (output, index[rows][output, tap] - start), weights[rows][output, tap])
        found.append(Piece(start, stop, torch.from_numpy(rows).to(device), torch.from_numpy(matrix).to(device)))
    return found


def add(coarser: Tensor, z: Tensor, row: Piece, column: Piece) -> None:
    """Adds what (h, w, Z) texels of a tile contribute to (H, W, Z) of a coarser level."""
    height, width, channels = z.shape
    part = torch.mm(row.weights, z.reshape(height, width * channels)).reshape(-1, width, channels)
    part = torch.matmul(column.weights, part)
    coarser.index_put_((row.rows[:, None], column.rows[None, :]), part, accumulate=True)


def extend(image: Tensor, border: int, wrap: Wrap) -> Tensor:
    """(B, H, W, C) to (B, H + 2 border, W + 2 border, C), the outside filled by the wrap mode of each axis."""
    rows = border_indices(-border, image.shape[1] + border, image.shape[1], wrap[1])
    columns = border_indices(-border, image.shape[2] + border, image.shape[2], wrap[0])
    return image[:, rows][:, :, columns]


def cut_out(
    image: NDArray[np.float32], rows: tuple[int, int], columns: tuple[int, int], border: int, wrap: Wrap
) -> Tensor:
    """(h + 2 border, w + 2 border, C) of (H, W, C): a tile of some rows and columns, with what lies around it."""
    row, column = (
        border_indices(first - border, last + border, size, mode).numpy()
        for (first, last), size, mode in zip((rows, columns), image.shape, reversed(wrap), strict=False)
    )
    return torch.from_numpy(image[np.ix_(row, column)])


def border_indices(start: int, stop: int, size: int, wrap: str) -> Tensor:
    """Texel that stands at each of start, ..., stop - 1 on an axis of that size and wrap mode."""
    index = torch.arange(start, stop)
    return index % size if wrap == "wrap" else index.clamp(0, size - 1)
