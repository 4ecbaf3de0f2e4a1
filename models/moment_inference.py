"""Baking with a MomentNetwork, tile by tile.

A 4096 x 4096 set would have 4 GiB of latents at level 0. They are never held: a tile is encoded with the texels around
it that its filter reaches, filtered, decoded as its part of level 0, and added into the levels that are filtered from
level 0, and into box averages half as fine, from which the coarser levels follow as `filtered_levels` makes them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.base import memory
from mipbake.material import directions, model_named, regularise
from mipbake.material.pixel_filter import Wrap, level_sizes, resample_weights
from mipbake.models.architecture import Levels
from mipbake.models.level_filter import FROM_TOP, Lookup, taps_of_top
from mipbake.models.lookup_kernel import sharpened
from mipbake.models.moment_network import MomentNetwork, with_detail
from mipbake.models.tiles import Piece, add, cut_out, pieces, tile_for
from mipbake.models.workers import baking_on


@dataclass(frozen=True)
class _Plan:
    """What is baked, and how: level 0 (H, W, R), what for, and the side of a tile."""

    network: MomentNetwork
    stored: NDArray[np.float32]
    lookup: Lookup
    wrap: Wrap
    tile: int

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Height and width of every level."""
        return level_sizes(*self.stored.shape[:2])


def bake_levels(
    network: MomentNetwork,
    stored: NDArray[np.float32],
    lookup: Lookup,
    wrap: Wrap,
    tile: int | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Levels:
    """`Baker.levels` by the network where it lies: tiles come back from there one by one.

    Args:
        tile: side of a tile in texels; the result does not depend on it beyond rounding. None: what suits the device.
    """
    plan = _Plan(network, np.ascontiguousarray(stored), lookup, wrap, tile or tile_for(network.device))
    with baking_on(network.device):
        top, latents = _from_top(plan, lambda share: progress(0.8 * share))
        levels = [top, *(_decoded(plan, latent, level) for level, latent in enumerate(latents, 1))]
    progress(1.0)
    (made,) = network.config.decoders
    return directions.agreeing([regularise(level, made) for level in levels], made, wrap)


@dataclass(frozen=True)
class _Sink:
    """An image that tiles add to: (H, W, Z), and the pieces of its rows and columns."""

    image: Tensor
    rows: Sequence[Piece]
    columns: Sequence[Piece]


def _sink(plan: _Plan, size: tuple[int, int], into: tuple[int, int], kernel: str, width: float = 1.0) -> _Sink:
    """What tiles of an image of a size are added to."""
    wrap, device = plan.wrap, plan.network.device
    rows, columns = (
        pieces(*resample_weights(size[axis], into[axis], kernel, wrap[1 - axis], width), size[axis], plan.tile, device)
        for axis in (0, 1)
    )
    return _Sink(torch.zeros(*into, plan.network.latent_channels, device=device), rows, columns)


def _filled(sink: _Sink, image: Tensor) -> Tensor:
    """The image of a sink after all tiles of (H, W, Z) were added."""
    for row in sink.rows:
        for column in sink.columns:
            add(sink.image, image[row.start : row.stop, column.start : column.stop], row, column)
    return sink.image


def _from_top(plan: _Plan, progress: Callable[[float], None]) -> tuple[NDArray[np.float32], list[Tensor]]:
    """Level 0 of the stack, and the filtered latents (H_L, W_L, Z) of every other level."""
    network, stored, lookup, wrap, tile = plan.network, plan.stored, plan.lookup, plan.wrap, plan.tile
    kernel, sizes, device = lookup.kernel, plan.sizes, network.device
    finest = list(enumerate(sizes))[1 : 1 + FROM_TOP]
    direct = [_sink(plan, sizes[0], size, kernel, lookup.width(level)) for level, size in finest]
    coarse = len(sizes) > 1 + FROM_TOP
    boxes = [_sink(plan, sizes[0], sizes[1], "box")] if coarse else []
    sharp, taps = taps_of_top(kernel)
    reach = len(taps) // 2 + 1  # and the sharpening's neighbour
    top = memory.empty((*sizes[0], model_named(network.config.decoders[0]).channels))
    first = torch.zeros(1, device=device)
    border = reach + network.halo
    corners = [(y, x) for y in range(0, sizes[0][0], tile) for x in range(0, sizes[0][1], tile)]

    def made(corner: tuple[int, int]) -> Tensor:
        """(h, w, Z) latents of a tile, whose part of level 0 is written."""
        (y, x), (height, width) = corner, sizes[0]
        stop = min(y + tile, height), min(x + tile, width)
        texels = cut_out(stored, (y, stop[0]), (x, stop[1]), border, wrap).to(device)
        around = network.encode_extended(texels[None])[0]
        filtered = with_detail(_valid(around, sharp), _valid(around[1:-1, 1:-1, : network.detail], taps))
        top[y : stop[0], x : stop[1]] = network.decode(filtered, first, kernel, lookup.sampler).cpu().numpy()
        return around[reach:-reach, reach:-reach]

    for done, (y, x) in enumerate(corners, 1):
        inside = made((y, x))
        for sink in (*direct, *boxes):
            add(sink.image, inside, sink.rows[y // tile], sink.columns[x // tile])
        progress(done / len(corners))
    latents = [sink.image for sink in direct]
    if boxes:
        box = boxes[0].image
        for level in range(1 + FROM_TOP, len(sizes)):
            finer = level - FROM_TOP
            if finer > 1:
                box = _filled(_sink(plan, sizes[finer - 1], sizes[finer], "box"), box)
            latents.append(_filled(_sink(plan, sizes[finer], sizes[level], kernel, lookup.width(level)), box))
    return top, latents


def _valid(image: Tensor, taps: NDArray[np.floating]) -> Tensor:
    """(H, W, Z) filtered along both axes with taps, where all of them lie inside."""
    first, *others = taps.tolist()
    for axis in (0, 1):
        size = image.shape[axis] - len(others)
        total = first * image.narrow(axis, 0, size)
        for i, weight in enumerate(others, 1):
            total.add_(image.narrow(axis, i, size), alpha=weight)
        image = total
    return image


def _decoded(plan: _Plan, latent: Tensor, level: int) -> NDArray[np.float32]:
    """(H, W, C) stored channels of a level's latents."""
    network, lookup, device = plan.network, plan.lookup, plan.network.device
    ready = with_detail(sharpened(latent, level, plan.wrap), latent[..., : network.detail])
    index = torch.full((1,), float(level), device=device)
    rows = torch.split(ready, max(1, tile_for(device) ** 2 // latent.shape[1]))  # as many texels at a time as a tile's
    parts = (network.decode(some, index, lookup.kernel, lookup.sampler).cpu().numpy() for some in rows)
    return np.concatenate(list(parts))
