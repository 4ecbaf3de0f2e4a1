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

from mipbake import directions, material
from mipbake.models.level_filter import FROM_TOP, Lookup, checked_filter, sharpening
from mipbake.models.lookup_kernel import sharpened
from mipbake.models.moment_network import MomentNetwork, with_detail
from mipbake.models.tiles import DEFAULT_TILE, Piece, add, border_indices, pieces
from mipbake.models.workers import in_order
from mipbake.pixel_filter import Wrap, level_sizes, resample, resample_weights


def bake(
    network: MomentNetwork,
    stored: NDArray[np.float32],
    source: str,
    target: str,
    lookup: Lookup,
    wrap: Wrap,
    progress: Callable[[float], None],
) -> list[NDArray[np.float32]]:
    """See MomentNetwork.bake."""
    checked_filter(network.config, network.pixel_filters, source, lookup.kernel)
    made, (read,) = network.config.made_from(target), network.config.encoders
    levels = bake_levels(network, material.convert(stored, source, read), lookup, wrap, progress=progress)
    if made == target:
        return levels
    converted = [material.regularise(material.convert(level, made, target), target) for level in levels]
    return directions.agreeing(converted, target, wrap)


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
    tile: int = DEFAULT_TILE,
    progress: Callable[[float], None] = lambda _: None,
) -> list[NDArray[np.float32]]:
    """Every level of the stack of a material, down to 1 x 1.

    Args:
        network: the trained network.
        stored: (H, W, R) stored channels of the model that is read, any size.
        lookup: what the levels are for. wrap: wrap mode along u and along v.
        tile: side of a tile in texels; the result does not depend on it beyond rounding.
        progress: told the finished share, from 0 to 1.

    Returns:
        (H_L, W_L, C) float32 stored channels of the model that the network makes, of every level.
    """
    plan = _Plan(network, np.ascontiguousarray(stored), lookup, wrap, tile)
    with torch.inference_mode():
        top, latents = _from_top(plan, lambda share: progress(0.8 * share))
        levels = [top, *(_decoded(plan, latent, level) for level, latent in enumerate(latents, 1))]
    progress(1.0)
    (made,) = network.config.decoders
    return directions.agreeing([material.regularise(level, made) for level in levels], made, wrap)


@dataclass(frozen=True)
class _Sink:
    """An image that tiles add to: (H, W, Z), and the pieces of its rows and columns."""

    image: Tensor
    rows: Sequence[Piece]
    columns: Sequence[Piece]


def _sink(plan: _Plan, into: tuple[int, int], kernel: str, width: float = 1.0) -> _Sink:
    size, wrap = plan.sizes[0], plan.wrap
    rows, columns = (
        pieces(*resample_weights(size[axis], into[axis], kernel, wrap[1 - axis], width), size[axis], plan.tile)
        for axis in (0, 1)
    )
    return _Sink(torch.zeros(*into, plan.network.latent_channels), rows, columns)


def _from_top(plan: _Plan, progress: Callable[[float], None]) -> tuple[NDArray[np.float32], list[Tensor]]:
    """Level 0 of the stack, and the filtered latents (H_L, W_L, Z) of every other level."""
    network, stored, lookup, wrap, tile = plan.network, plan.stored, plan.lookup, plan.wrap, plan.tile
    kernel = lookup.kernel
    sizes = plan.sizes
    finest = list(enumerate(sizes))[1 : 1 + FROM_TOP]
    direct = [_sink(plan, size, kernel, lookup.width(level)) for level, size in finest]
    coarse = len(sizes) > 1 + FROM_TOP
    boxes = [_sink(plan, sizes[1], "box")] if coarse else []
    taps = resample_weights(16, 16, kernel, "wrap")[1][0]  # the same for every texel of a level 0
    a = sharpening(0)
    sharp = np.convolve(taps, [-a, 1 + 2 * a, -a])
    reach = len(taps) // 2 + 1  # and the sharpening's neighbour
    top = np.empty((*sizes[0], material.model_named(network.config.decoders[0]).channels), np.float32)
    border = reach + network.halo
    corners = [(y, x) for y in range(0, sizes[0][0], tile) for x in range(0, sizes[0][1], tile)]

    def made(corner: tuple[int, int]) -> Tensor:
        """(h, w, Z) latents of a tile, whose part of level 0 is written."""
        (y, x), (height, width) = corner, sizes[0]
        stop = min(y + tile, height), min(x + tile, width)
        rows = border_indices(y - border, stop[0] + border, height, wrap[1]).numpy()
        columns = border_indices(x - border, stop[1] + border, width, wrap[0]).numpy()
        around = network.encode_extended(torch.from_numpy(stored[np.ix_(rows, columns)])[None])[0]
        filtered = with_detail(_valid(around, sharp), _valid(around[1:-1, 1:-1, : network.detail], taps))
        top[y : stop[0], x : stop[1]] = network.decode(filtered, torch.zeros(1), kernel, lookup.sampler).numpy()
        return around[reach:-reach, reach:-reach]

    for done, ((y, x), inside) in enumerate(zip(corners, in_order(made, corners), strict=True), 1):
        for sink in (*direct, *boxes):
            add(sink.image, inside, sink.rows[y // tile], sink.columns[x // tile])
        progress(done / len(corners))
    latents = [sink.image for sink in direct]
    if boxes:
        box = boxes[0].image.numpy()
        for level in range(1 + FROM_TOP, len(sizes)):
            finer = level - FROM_TOP
            if finer > 1:
                box = resample(box, sizes[finer], "box", wrap)
            latents.append(torch.from_numpy(resample(box, sizes[level], kernel, wrap, lookup.width(level))))
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
    ready = with_detail(sharpened(latent, level, plan.wrap), latent[..., : plan.network.detail])
    index = torch.full((1,), float(level))
    rows = torch.split(ready, max(1, DEFAULT_TILE**2 // latent.shape[1]))  # as many texels at a time as of level 0
    lookup = plan.lookup
    parts = in_order(lambda some: plan.network.decode(some, index, lookup.kernel, lookup.sampler).numpy(), rows)
    return np.concatenate(list(parts))
