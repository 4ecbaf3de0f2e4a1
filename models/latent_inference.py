"""Baking with a LatentNetwork, tile by tile.

Level 0 of a 4096 x 4096 set would have 4 GiB of latents. They are never held: a tile of level 0 is encoded, decoded and
added into the latents of level 1, which linear downsampling allows, and forgotten. Further levels go the same way, so
that two levels of latents at most exist at once, the finest of them a quarter the size of level 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.base import memory
from mipbake.material import directions, model_named
from mipbake.material.pixel_filter import Wrap, level_sizes
from mipbake.models.architecture import Levels
from mipbake.models.latent_filter import latent_weights
from mipbake.models.latent_network import LatentNetwork
from mipbake.models.tiles import Piece, add, cut_out, pieces, tile_for
from mipbake.models.workers import baking_on


def bake_levels(
    network: LatentNetwork,
    stored: NDArray[np.float32],
    wrap: Wrap,
    tile: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
    source: str | None = None,
    target: str | None = None,
) -> Levels:
    """`Baker.levels` by the network where it lies: tiles come back from there one by one.

    Args:
        tile: side of a tile in texels; the result does not depend on it beyond rounding. None: what suits the device.
        source, target: the encoder and the decoder, where the network has several.
    """
    sizes, device, made = level_sizes(*stored.shape[:2]), network.device, target or network.config.decoders[0]
    tile = tile or tile_for(device)
    texels = sum(height * width for height, width in sizes)
    done = 0
    levels = []
    latent: Tensor | None = None
    with baking_on(device):
        for level, (height, width) in enumerate(sizes):
            down = sizes[level + 1] if level + 1 < len(sizes) else None
            columns = _pieces(width, down and down[1], tile, network, wrap[0], level == 0)
            coarser = torch.zeros(*down, network.config.latent_channels, device=device) if down else None
            out = memory.empty((height, width, model_named(made).channels))
            for row in _pieces(height, down and down[0], tile, network, wrap[1], level == 0):
                for column in columns:
                    part = slice(row.start, row.stop), slice(column.start, column.stop)
                    z = _encode_tile(network, stored, wrap, row, column, source) if latent is None else latent[part]
                    out[part] = network.decode(z, target).cpu().numpy()
                    if coarser is not None:
                        add(coarser, z, row, column)
                    done += z.shape[0] * z.shape[1]
                    progress(done / texels)
            levels.append(out)
            latent = coarser
    return directions.agreeing(levels, made, wrap)


def _encode_tile(
    network: LatentNetwork, stored: NDArray[np.float32], wrap: Wrap, row: Piece, column: Piece, source: str | None
) -> Tensor:
    """(h, w, Z) latents of one tile of level 0."""
    around = cut_out(stored, (row.start, row.stop), (column.start, column.stop), network.halo, wrap)
    return network.encode_extended(around.to(network.device)[None], source)[0]


def _pieces(n_in: int, n_out: int | None, tile: int, network: LatentNetwork, wrap: str, first: bool) -> list[Piece]:
    if n_out is None:
        return [Piece(0, n_in, torch.empty(0), torch.empty(0))]
    index, weights = latent_weights(n_in, n_out, network.config.latent_filter, wrap, first)
    return pieces(index, weights, n_in, tile, network.device)
