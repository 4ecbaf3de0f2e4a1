"""Texture lookups as torch ops: differentiable, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mipbake.base.aligned import dense
from mipbake.base.first_order import refuse_second_derivatives
from mipbake.base.stream import current_stream
from mipbake.sampling import _forward
from mipbake.sampling._forward import empty_levels, empty_result, flat, flat_bias, images, readable, together

__all__ = ["mips", "texture"]


mips = torch.library.custom_op(
    "mipbake::texture_mips", _forward.mips, mutates_args=(), schema="(Tensor tex, int count) -> Tensor[]"
)


@mips.register_fake
def _(tex: Tensor, count: int) -> list[Tensor]:
    return empty_levels(tex, count)


texture = torch.library.custom_op(
    "mipbake::texture",
    _forward.texture,
    mutates_args=(),
    schema="(Tensor[] levels, Tensor uv, Tensor? uv_da, Tensor? bias, str filter, str boundary_u, str boundary_v, "
    "bool chain) -> Tensor",
)


@texture.register_fake
def _(levels: Sequence[Tensor], uv: Tensor, uv_da: Tensor | None, bias: Tensor | None, *_modes: Any) -> Tensor:
    result: Tensor = empty_result(levels, uv, uv_da, bias)
    return result


@torch.library.custom_op(
    "mipbake::texture_backward",
    mutates_args=(),
    schema="(Tensor grad, Tensor[] levels, Tensor uv, Tensor? uv_da, Tensor? bias, str filter, str boundary_u, "
    "str boundary_v, bool chain, bool[] needs) -> Tensor[]",
)
def _texture_backward(
    grad: Tensor,
    levels: Sequence[Tensor],
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    filter_mode: str,
    boundary_u: str,
    boundary_v: str,
    chain: bool,
    needs: Sequence[bool],
) -> list[Tensor]:
    """The gradients that are needed, in the order of the arguments; gradients of lookups come before any sum over
    repeats.

    needs: of levels, uv, uv_da and bias. A chain has one level's gradient, the first's.
    """
    from mipbake import _native

    need_levels = needs[0]
    level_grads = [grad.new_empty(level.shape) for level in levels] if need_levels else []
    every = [grad.new_empty(shape) if need else None for shape, need in zip(_shapes(grad, uv), needs[1:], strict=True)]
    lookup_grads = [g for g in every if g is not None]
    if grad.numel() == 0:
        level_grads = [g.zero_() for g in level_grads]
    else:
        by_uv, by_uv_da, by_bias = (None if g is None else together(g) for g in every)
        with current_stream(uv, "tex") as stream:
            _native.texture_backward(
                together(dense(grad)),
                [readable(level, need_levels) for level in levels],
                flat(uv),
                flat(uv_da),
                flat_bias(bias, uv),
                filter_mode,
                boundary_u,
                boundary_v,
                level_grads,
                by_uv,
                by_uv_da,
                by_bias,
                stream,
            )
            if chain:
                for coarser, finer in zip(level_grads[:0:-1], level_grads[-2::-1], strict=True):
                    _native.texture_mip_backward(images(coarser), images(finer), stream)
    if chain:
        level_grads = level_grads[:1]
    return [*(g.to(levels[0].dtype) for g in level_grads), *lookup_grads]


@_texture_backward.register_fake
def _(
    grad: Tensor, levels: Sequence[Tensor], uv: Tensor, _uv_da: Tensor | None, _bias: Tensor | None, *rest: Any
) -> list[Tensor]:
    chain, (need_levels, *needs) = rest[-2:]
    return [
        *([level.new_empty(level.shape) for level in levels[: 1 if chain else None]] if need_levels else []),
        *(grad.new_empty(shape) for shape, need in zip(_shapes(grad, uv), needs, strict=True) if need),
    ]


def _shapes(grad: Tensor, uv: Tensor) -> tuple[tuple[int, ...], ...]:
    """Of the gradients of uv, uv_da and bias, before any sum over repeats."""
    lookups, axes = tuple(grad.shape[:3]), uv.shape[-1]
    return (*lookups, axes), (*lookups, 2 * axes), lookups


def _setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:  # noqa: ARG001
    levels, uv, uv_da, bias, *ctx.modes = inputs
    ctx.count = len(levels)
    ctx.save_for_backward(*levels, uv, uv_da, bias)


def _backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
    levels, lookups = ctx.saved_tensors[: ctx.count], ctx.saved_tensors[ctx.count :]
    level_needs, *needs = ctx.needs_input_grad[:4]
    if ctx.modes[-1]:  # a chain: the levels after the first are made from it
        level_needs = [level_needs[0], *(False for _ in level_needs[1:])]
    gradients = iter(_texture_backward(grad, levels, *lookups, *ctx.modes, [any(level_needs), *needs]))
    own = [next(gradients) for _ in levels[: 1 if ctx.modes[-1] else None]] if any(level_needs) else []
    own += [None] * (len(levels) - len(own))
    return (
        [g if need else None for g, need in zip(own, level_needs, strict=True)],
        *(
            _sum_to(next(gradients), argument.shape) if need else None
            for argument, need in zip(lookups, needs, strict=True)
        ),
        *(None for _ in ctx.modes),
    )


texture.register_autograd(_backward, setup_context=_setup_context)
refuse_second_derivatives(_texture_backward, "texture")


def _sum_to(grad: Tensor, shape: torch.Size) -> Tensor:
    """Sums over the axes along which an argument of that shape was repeated, in a fixed order."""
    axes = [axis for axis, size in enumerate(shape) if size == 1 and grad.shape[axis] != 1]
    if not axes:
        return grad
    if shape.numel() != 1:
        return grad.sum(axes, keepdim=True)
    # Two stages: torch splits the sum of a long vector among its threads, but not the sum of a short vector or of rows.
    flat = grad.reshape(-1)
    rows = torch.nn.functional.pad(flat, (0, -flat.shape[0] % 256)).view(256, -1)
    return rows.sum(1).sum().reshape(shape)
