"""The raster primitives as torch ops: differentiable, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mipbake.base.aligned import dense
from mipbake.base.first_order import refuse_second_derivatives
from mipbake.base.stream import current_stream, errors_of_data
from mipbake.raster import _forward
from mipbake.raster._forward import empty_attributes, empty_rasters, optional, silhouette_scratch

__all__ = ["antialias", "interpolate", "rasterize", "topology"]


def _empty_gradients(*likes: tuple[Tensor, bool]) -> list[Tensor | None]:
    """Where gradients are written, None where none is needed."""
    return [like.new_empty(like.shape) if needed else None for like, needed in likes]


# ---- rasterize ----

rasterize = torch.library.custom_op(
    "mipbake::rasterize",
    _forward.rasterize,
    mutates_args=(),
    schema="(Tensor pos, Tensor tri, SymInt height, SymInt width, Tensor? ranges, Tensor? previous, SymInt scratch,"
    " bool grad_db=True) -> (Tensor, Tensor)",
)


@rasterize.register_fake
def _(pos: Tensor, _tri: Tensor, height: int, width: int, ranges: Tensor | None, *_rest: Any) -> tuple[Tensor, Tensor]:
    return empty_rasters(pos, ranges, height, width)


@torch.library.custom_op("mipbake::rasterize_backward", mutates_args=())
def rasterize_backward(pos: Tensor, tri: Tensor, rast: Tensor, grad_rast: Tensor, grad_db: Tensor | None) -> Tensor:
    from mipbake import _native

    grad_pos = pos.new_empty(pos.shape)
    if rast.numel() == 0 or tri.shape[0] == 0:
        return grad_pos.zero_()
    with errors_of_data(), current_stream(pos, "pos") as stream:
        _native.rasterize_backward(
            dense(pos), dense(tri), dense(rast), dense(grad_rast), optional(grad_db), grad_pos, stream
        )
    return grad_pos


@rasterize_backward.register_fake
def _(pos: Tensor, _tri: Tensor, _rast: Tensor, _grad_rast: Tensor, _grad_db: Tensor | None) -> Tensor:
    return pos.new_empty(pos.shape)


def _setup_rasterize(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    ctx.set_materialize_grads(False)
    ctx.grad_db = inputs[-1]
    ctx.save_for_backward(inputs[0], inputs[1], output[0])


def _backward_rasterize(ctx: Any, grad_rast: Tensor | None, grad_db: Tensor | None) -> tuple[Tensor | None, ...]:
    pos, tri, rast = ctx.saved_tensors
    grad_db = grad_db if ctx.grad_db else None
    grad_pos = None
    if ctx.needs_input_grad[0] and not (grad_rast is None and grad_db is None):
        grad_rast = torch.zeros_like(rast) if grad_rast is None else grad_rast
        grad_pos = rasterize_backward(pos, tri, rast, grad_rast, grad_db)
    elif ctx.needs_input_grad[0]:
        grad_pos = torch.zeros_like(pos)
    return grad_pos, None, None, None, None, None, None, None


rasterize.register_autograd(_backward_rasterize, setup_context=_setup_rasterize)
refuse_second_derivatives(rasterize_backward, "rasterize")


# ---- interpolate ----

interpolate = torch.library.custom_op(
    "mipbake::interpolate",
    _forward.interpolate,
    mutates_args=(),
    schema="(Tensor attr, Tensor rast, Tensor tri, Tensor? rast_db, SymInt[] diff_attrs) -> (Tensor, Tensor)",
)


@interpolate.register_fake
def _(
    attr: Tensor, rast: Tensor, _tri: Tensor, _rast_db: Tensor | None, diff_attrs: Sequence[int]
) -> tuple[Tensor, Tensor]:
    return empty_attributes(attr, rast, diff_attrs)


@torch.library.custom_op(
    "mipbake::interpolate_backward",
    mutates_args=(),
    schema="(Tensor attr, Tensor rast, Tensor tri, Tensor? rast_db, SymInt[] diff_attrs, Tensor grad_out, "
    "Tensor? grad_da, bool need_attr, bool need_rast, bool need_db) -> Tensor[]",
)
def interpolate_backward(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None,
    diff_attrs: Sequence[int],
    grad_out: Tensor,
    grad_da: Tensor | None,
    *needs: bool,
) -> list[Tensor]:
    """The gradients that are needed, in the order of the arguments."""
    from mipbake import _native

    by_attr, by_rast, by_db = every = _empty_gradients(*zip((attr, rast, rast), needs, strict=True))
    gradients = [each for each in every if each is not None]
    if grad_out.numel() == 0 or tri.shape[0] == 0:
        return [gradient.zero_() for gradient in gradients]
    attr, rast, tri, rast_db = dense(attr), dense(rast), dense(tri), optional(rast_db)
    grad_out, grad_da, selected = dense(grad_out), optional(grad_da), list(diff_attrs)
    with errors_of_data(), current_stream(attr, "attr") as stream:
        _native.interpolate_backward(
            attr, rast, tri, rast_db, selected, grad_out, grad_da, by_attr, by_rast, by_db, stream
        )
    return gradients


@interpolate_backward.register_fake
def _(attr: Tensor, rast: Tensor, *rest: Any) -> list[Tensor]:
    every = _empty_gradients(*zip((attr, rast, rast), rest[-3:], strict=True))
    return [each for each in every if each is not None]


def _setup_interpolate(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:  # noqa: ARG001
    ctx.set_materialize_grads(False)
    *tensors, ctx.diff_attrs = inputs
    ctx.save_for_backward(*tensors)


def _backward_interpolate(ctx: Any, grad_out: Tensor | None, grad_da: Tensor | None) -> tuple[Tensor | None, ...]:
    attr, rast, tri, rast_db = ctx.saved_tensors
    need_attr, need_rast, _, need_db, _ = ctx.needs_input_grad
    if grad_out is None and grad_da is None:
        return None, None, None, None, None
    if grad_out is None:
        grad_out = attr.new_zeros((*rast.shape[:3], attr.shape[-1]))
    needs = need_attr, need_rast, need_db and grad_da is not None
    gradients = iter(interpolate_backward(attr, rast, tri, rast_db, ctx.diff_attrs, grad_out, grad_da, *needs))
    grad_attr, grad_rast, grad_db = (next(gradients) if need else None for need in needs)
    return grad_attr, grad_rast, None, grad_db, None


interpolate.register_autograd(_backward_interpolate, setup_context=_setup_interpolate)
refuse_second_derivatives(interpolate_backward, "interpolate")


# ---- antialias ----

topology = torch.library.custom_op(
    "mipbake::antialias_topology", _forward.topology, mutates_args=(), schema="(Tensor tri, SymInt vertices) -> Tensor"
)


@topology.register_fake
def _(tri: Tensor, _vertices: int) -> Tensor:
    return tri.new_empty(tri.shape)


antialias = torch.library.custom_op(
    "mipbake::antialias",
    _forward.antialias,
    mutates_args=(),
    schema="(Tensor color, Tensor rast, Tensor pos, Tensor tri, Tensor following, float boost) -> Tensor",
)


@antialias.register_fake
def _(color: Tensor, *_rest: Any) -> Tensor:
    return color.new_empty(color.shape)


@torch.library.custom_op(
    "mipbake::antialias_backward",
    mutates_args=(),
    schema="(Tensor color, Tensor rast, Tensor pos, Tensor tri, Tensor following, Tensor grad, float boost, "
    "bool need_color, bool need_pos) -> Tensor[]",
)
def antialias_backward(
    color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, following: Tensor, grad: Tensor, boost: float, *needs: bool
) -> list[Tensor]:
    """The gradients that are needed, of color and of pos."""
    from mipbake import _native

    by_color, by_pos = every = _empty_gradients(*zip((color, pos), needs, strict=True))
    gradients = [each for each in every if each is not None]
    if grad.numel() == 0:
        return [gradient.zero_() for gradient in gradients]
    scratch = silhouette_scratch(pos, tri)
    color, rast, pos, tri, following, grad = map(dense, (color, rast, pos, tri, following, grad))
    with errors_of_data(), current_stream(color, "color") as stream:
        _native.antialias_backward(color, rast, pos, tri, following, grad, boost, by_color, by_pos, scratch, stream)
    return gradients


@antialias_backward.register_fake
def _(color: Tensor, _rast: Tensor, pos: Tensor, *rest: Any) -> list[Tensor]:
    return [each for each in _empty_gradients(*zip((color, pos), rest[-2:], strict=True)) if each is not None]


def _setup_antialias(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:  # noqa: ARG001
    *tensors, ctx.boost = inputs
    ctx.save_for_backward(*tensors)


def _backward_antialias(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
    need_color, _, need_pos = ctx.needs_input_grad[:3]
    gradients = iter(antialias_backward(*ctx.saved_tensors, grad, ctx.boost, need_color, need_pos))
    grad_color, grad_pos = (next(gradients) if need else None for need in (need_color, need_pos))
    return grad_color, None, grad_pos, None, None, None


antialias.register_autograd(_backward_antialias, setup_context=_setup_antialias)
refuse_second_derivatives(antialias_backward, "antialias")
