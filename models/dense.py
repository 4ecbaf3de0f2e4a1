"""Dense layers as few large products, with a gradient of their own.

Every layer of a dense block reads all maps before it. So each group of maps is multiplied once, by the weights that all
later layers have for it, and their sums wait: few large products in place of many small ones and of copies. Left to
autograd, the slices and concatenations that this takes cost more than the products; here the adjoint is written out.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

SLOPE = 0.1
"""Slope of the leaky rectifier below zero: no unit dies, and it costs what a plain rectifier does."""

Shape = tuple[int, int]


def dense(maps: Tensor, weights: list[Tensor], biases: list[Tensor], periodic: Shape | None = None) -> Tensor:
    """All maps of a dense block: those given, then the new ones of each layer, rectified.

    Args:
        maps: (B, N, C) of B images of N texels.
        weights: of layer i, (G, C + i G), or (G, C + i G, 3, 3) where texels see their neighbours; all alike.
        biases: (G,) each.
        periodic: height and width of the images, N texels row by row, where texels see their neighbours; beyond its
            borders an image repeats.

    Returns:
        (B, N, C + len(weights) G), differentiable in everything.
    """
    out: Tensor = _Dense.apply(maps, periodic, *weights, *biases)  # type: ignore[no-untyped-call]
    return out


class _Dense(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, maps: Tensor, periodic: Shape | None, *parameters: Tensor) -> Tensor:
        layers = len(parameters) // 2
        weights, growth, inputs = parameters[:layers], parameters[0].shape[0], maps.shape[-1]
        out = maps.new_empty((*maps.shape[:2], inputs + growth * layers))
        out[..., :inputs] = maps
        sums, seen, grouped, columns = torch.cat(parameters[layers:]), 0, [], []
        for i in range(layers):
            group = inputs if i == 0 else growth
            matrix = _grouped(weights[i:], slice(seen, seen + group))
            column = _columns(out[..., seen : seen + group], periodic)
            product = functional.linear(column, matrix)
            product += sums
            functional.leaky_relu_(product[..., :growth], SLOPE)
            seen += group
            out[..., seen : seen + growth] = product[..., :growth]
            sums = product[..., growth:]
            grouped.append(matrix)
            columns.append(column)
        ctx.save_for_backward(out, *grouped, *(columns if periodic else ()))
        ctx.periodic, ctx.inputs, ctx.shapes = periodic, inputs, [w.shape for w in weights]
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        out, *saved = ctx.saved_tensors
        layers, inputs = len(ctx.shapes), ctx.inputs
        matrices, columns = saved[:layers], saved[layers:]
        growth, *_ = ctx.shapes[0]
        taps = 9 if ctx.periodic else 1
        by_maps = grads[0].clone()
        by_sums = out.new_empty((*out.shape[:2], growth * layers))
        by_weights = [out.new_empty(growth, taps, shape[1]) for shape in ctx.shapes]
        for i in reversed(range(layers)):
            new = slice(inputs + i * growth, inputs + (i + 1) * growth)
            by_sums[..., i * growth : (i + 1) * growth] = torch.ops.aten.leaky_relu_backward(
                by_maps[..., new], out[..., new], SLOPE, True
            )
            later = by_sums[..., i * growth :]
            seen = slice(0, inputs) if i == 0 else slice(new.start - growth, new.start)
            column = columns[i] if columns else out[..., seen]
            by_matrix = torch.mm(later.flatten(0, 1).T, column.flatten(0, 1))
            by_matrix = by_matrix.reshape(len(by_matrix), -1, seen.stop - seen.start)
            for j in range(i, layers):
                by_weights[j][..., seen] = by_matrix[(j - i) * growth : (j - i + 1) * growth]
            if i > 0 or ctx.needs_input_grad[0]:
                by_maps[..., seen] += _columns_adjoint(torch.matmul(later, matrices[i]), ctx.periodic)
        by_biases = by_sums.sum((0, 1)).split(growth)
        by_inputs = by_maps[..., :inputs] if ctx.needs_input_grad[0] else None
        return (
            by_inputs,
            None,
            *(_as_weights(w, shape) for w, shape in zip(by_weights, ctx.shapes, strict=True)),
            *by_biases,
        )


def _as_weights(gradient: Tensor, shape: torch.Size) -> Tensor:
    """(G, taps, maps read) as the weights lie: maps last in memory."""
    return gradient.reshape(len(gradient), 3, 3, -1).movedim(-1, 1) if len(shape) == 4 else gradient[:, 0]


def _grouped(weights: tuple[Tensor, ...], maps: slice) -> Tensor:
    """Weights that layers have for a group of maps: (layers G, taps group)."""
    return torch.cat([w.movedim(1, -1)[..., maps].flatten(1) for w in weights])


def _columns(maps: Tensor, periodic: Shape | None) -> Tensor:
    """(B, N, C) to (B, N, taps C): each texel's neighbours side by side."""
    if periodic is None:
        return maps
    neighbours, _ = _neighbours(*periodic, maps.device)
    return maps.index_select(1, neighbours).reshape(*maps.shape[:2], -1)


def _columns_adjoint(columns: Tensor, periodic: Shape | None) -> Tensor:
    if periodic is None:
        return columns
    _, places = _neighbours(*periodic, columns.device)
    batch, texels, width = columns.shape
    return columns.reshape(batch, texels * 9, width // 9).index_select(1, places).reshape(batch, texels, 9, -1).sum(2)


@lru_cache(maxsize=16)
def _neighbours(height: int, width: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """For every texel: its 3 x 3 neighbours, and the places that it has itself among the neighbours of others."""
    index = torch.arange(height * width).reshape(height, width)
    offsets = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    neighbours = [index.roll((-dy, -dx), (0, 1)).flatten() for dy, dx in offsets]
    places = [index.roll((dy, dx), (0, 1)).flatten() * 9 + tap for tap, (dy, dx) in enumerate(offsets)]
    with torch.inference_mode(False):  # whoever asks first, training may ask later
        return torch.stack(neighbours, 1).flatten().to(device), torch.stack(places, 1).flatten().to(device)
