"""Texture lookups and MIP levels forward, on arrays or tensors that were checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mipbake.base.aligned import dense, strided
from mipbake.base.arguments import empty, is_array
from mipbake.base.stream import current_stream
from mipbake.sampling._arguments import level_sizes


def mips(tex: Any, count: int) -> list[Any]:
    """The first `count` levels after `tex`, each from the one before."""
    from mipbake import _native

    levels, finer = empty_levels(tex, count), dense(tex)
    with current_stream(tex, "tex") as stream:
        for level in levels:
            _native.texture_mip(images(finer), images(level), stream)
            finer = level
    return levels


def texture(
    levels: Sequence[Any],
    uv: Any,
    uv_da: Any,
    bias: Any,
    filter_mode: str,
    boundary_u: str,
    boundary_v: str,
    chain: bool,  # noqa: ARG001
) -> Any:
    """(B, h, w, C) lookups; arguments are as in `mipbake.sampling.texture`, but in the dtype of the result.

    `chain`: all levels come from the first, which takes all the gradient.
    """
    from mipbake import _native

    out = empty_result(levels, uv, uv_da, bias)
    if 0 not in out.shape:
        with current_stream(uv, "tex") as stream:
            texels = [readable(level) for level in levels]
            lookups = flat(uv), flat(uv_da), flat_bias(bias, uv)
            _native.texture(texels, *lookups, filter_mode, boundary_u, boundary_v, together(out), stream)
    return out


def empty_levels(tex: Any, count: int) -> list[Any]:
    """Where `count` levels after `tex` are written."""
    sizes = level_sizes(tex.shape[-3], tex.shape[-2], count)
    return [empty(tex, (*tex.shape[:-3], *size, tex.shape[-1])) for size in sizes[1:]]


def empty_result(levels: Sequence[Any], uv: Any, uv_da: Any, bias: Any) -> Any:
    """Where lookups are written."""
    batch = uv.shape[0]
    for each in (levels[0], uv_da, bias):
        if each is not None and batch == 1:
            batch = each.shape[0]
    return empty(uv, (batch, *uv.shape[1:3], levels[0].shape[-1]))


def images(level: Any) -> Any:
    """A cube map's faces as images of their own."""
    return level.reshape(-1, *level.shape[2:]) if level.ndim == 5 else level


def readable(level: Any, own_items: bool = False) -> Any:
    """The level itself, or a copy where its channels do not lie side by side, or its items in the same place."""
    step = level.strides[-1] // level.itemsize if is_array(level) else level.stride(-1)
    shares = own_items and level.shape[0] > 1 and level.stride(0) == 0
    return strided(level) if (step == 1 or level.shape[-1] == 1) and not shares else dense(level)


def together(lookups: Any) -> Any:
    """(B, h, w, n) as (B, P, n), in place."""
    return lookups.reshape(lookups.shape[0], -1, *lookups.shape[3:])


def flat(lookups: Any) -> Any:
    """(B | 1, h, w, n) to (B | 1, P, n), contiguous; one item where all repeat it."""
    if lookups is None:
        return None
    repeats = not is_array(lookups) and lookups.shape[0] > 1 and lookups.stride(0) == 0
    return together(dense(lookups[:1] if repeats else lookups))


def flat_bias(bias: Any, uv: Any) -> Any:
    """(B | 1, h | 1, w | 1) to (B | 1, P), or to (B | 1, 1) where it is the same for all lookups of an item."""
    if bias is None:
        return None
    if tuple(bias.shape[1:]) != (1, 1):
        shape = (bias.shape[0], *uv.shape[1:3])
        bias = np.broadcast_to(bias, shape) if is_array(bias) else bias.expand(shape)
    bias = dense(bias)
    return bias.reshape(bias.shape[0], -1)
