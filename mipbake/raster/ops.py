"""The raster primitives as torch ops: differentiable, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from mipbake.base.aligned import aligned, check_dense
from mipbake.base.errors import UsageError
from mipbake.base.forward_mode import refuse_tangents
from mipbake.base.stream import current_stream
from mipbake.raster import _device
from mipbake.raster._arguments import (
    Described,
    attributes_of,
    boost_of,
    check_antialias,
    check_context,
    check_topology,
    check_triangles,
    image_shape,
    size_of,
)
from mipbake.raster.context import RasterizeContext, Topology

__all__ = ["antialias", "antialias_construct_topology_hash", "interpolate", "rasterize"]

_NAMES = {dtype: str(dtype).removeprefix("torch.") for dtype in (torch.float32, torch.float64, torch.int32)}


def rasterize(
    ctx: RasterizeContext | None,
    pos: Tensor,
    tri: Tensor,
    resolution: Sequence[int],
    ranges: Tensor | None = None,
    grad_db: bool = True,
    previous: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """`mipbake.raster.rasterize`; with `previous`, the first of its results, only what lies behind that."""
    check_context(ctx, RasterizeContext)
    described_pos = _described("pos", pos)
    if len(described_pos.shape) == 3:
        ranges = None
    described = None if ranges is None else _described("ranges", ranges)
    size = size_of(resolution)
    image_shape(described_pos, _described("tri", tri), described, size)
    refuse_tangents(pos=pos)
    previous = None if previous is None else previous.detach()
    rast, rast_db = _rasterize(pos, tri, *size, ranges, previous, 0 if ctx is None else ctx.handle)
    return rast, rast_db if grad_db else rast_db.detach()


def interpolate(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None = None,
    diff_attrs: Sequence[int] | str | None = None,
) -> tuple[Tensor, Tensor]:
    """`mipbake.raster.interpolate`."""
    selected = attributes_of(
        _described("attr", attr),
        _described("rast", rast),
        _described("tri", tri),
        None if rast_db is None else _described("rast_db", rast_db),
        diff_attrs,
    )
    refuse_tangents(attr=attr, rast=rast, rast_db=rast_db)
    out, out_da = _interpolate(attr, rast, tri, rast_db if selected else None, selected)
    return out, out_da


def antialias(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    topology_hash: Topology | None = None,
    pos_gradient_boost: float = 1.0,
) -> Tensor:
    """`mipbake.raster.antialias`."""
    triangles = _described("tri", tri)
    check_antialias(_described("color", color), _described("rast", rast), _described("pos", pos), triangles)
    boost = boost_of(pos_gradient_boost)
    refuse_tangents(color=color, pos=pos)
    following = _topology(tri, pos.shape[-2]) if topology_hash is None else _next_of(topology_hash, triangles)
    out: Tensor = _antialias(color, rast, pos, tri, following, boost)
    return out


def antialias_construct_topology_hash(tri: Tensor) -> Topology:
    """`mipbake.raster.antialias_construct_topology_hash`."""
    check_triangles(_described("tri", tri))
    return Topology(_topology(tri, -1))


def _described(name: str, tensor: Any) -> Described:
    if not isinstance(tensor, Tensor):
        raise UsageError(f"{name} is a {type(tensor).__name__}: expected a torch tensor, or NumPy arrays alone")
    check_dense(name, tensor)
    if tensor.device.type not in ("cpu", "cuda", "meta"):
        raise UsageError(f"{name} is on {tensor.device}: expected the CPU or CUDA")
    dtype = _NAMES.get(tensor.dtype) or str(tensor.dtype).removeprefix("torch.")
    return Described(name, tuple(tensor.shape), dtype, str(tensor.device))


def _next_of(topology: Any, tri: Described) -> Tensor:
    if not isinstance(topology, Topology) or not isinstance(topology.next, Tensor):
        raise UsageError(
            f"topology_hash is a {type(topology).__name__}: expected what antialias_construct_topology_hash(tri) "
            "gives for a torch tensor, or None"
        )
    check_topology(topology.next.shape[0], str(topology.next.device), tri)
    return topology.next


@contextmanager
def _errors_of_data() -> Iterator[None]:
    """The native core's ValueError is about the numbers in an argument, and says so in a whole sentence."""
    try:
        yield
    except ValueError as error:
        raise UsageError(str(error)) from None


def _plain(tensor: Tensor) -> Tensor:
    """A tensor as the native core reads it: contiguous, aligned, and no part of a graph."""
    return aligned(tensor.detach().contiguous())


def _optional(tensor: Tensor | None) -> Tensor | None:
    return None if tensor is None else _plain(tensor)


# ---- rasterize ----


@torch.library.custom_op(
    "mipbake::rasterize",
    mutates_args=(),
    schema="(Tensor pos, Tensor tri, SymInt height, SymInt width, Tensor? ranges, Tensor? previous, SymInt scratch)"
    " -> (Tensor, Tensor)",
)
def _rasterize(
    pos: Tensor,
    tri: Tensor,
    height: int,
    width: int,
    ranges: Tensor | None,
    previous: Tensor | None,
    scratch: int,
) -> tuple[Tensor, Tensor]:
    from mipbake import _native

    rast, rast_db = _empty_rasters(pos, ranges, height, width)
    pos, tri, ranges, previous = _plain(pos), _plain(tri), _optional(ranges), _optional(previous)
    with _errors_of_data(), current_stream(pos, "pos") as stream:
        _device.check(tri, pos.shape[-2], pos=pos, ranges=ranges)
        if rast.numel() == 0:
            return rast, rast_db
        workspace = None
        if pos.is_cuda:
            size = _native.rasterize_workspace(rast.shape[0], tri.shape[0], height, width)
            workspace = pos.new_empty(size, dtype=torch.uint8)
        _native.rasterize(pos, tri, ranges, previous, rast, rast_db, scratch, workspace, stream)
    return rast, rast_db


@_rasterize.register_fake
def _(
    pos: Tensor, _tri: Tensor, height: int, width: int, ranges: Tensor | None, _previous: Tensor | None, _scratch: int
) -> tuple[Tensor, Tensor]:
    return _empty_rasters(pos, ranges, height, width)


@torch.library.custom_op("mipbake::rasterize_backward", mutates_args=())
def _rasterize_backward(pos: Tensor, tri: Tensor, rast: Tensor, grad_rast: Tensor, grad_db: Tensor | None) -> Tensor:
    from mipbake import _native

    grad_pos = pos.new_empty(pos.shape)
    if rast.numel() == 0 or tri.shape[0] == 0:
        return grad_pos.zero_()
    with _errors_of_data(), current_stream(pos, "pos") as stream:
        _native.rasterize_backward(
            _plain(pos), _plain(tri), _plain(rast), _plain(grad_rast), _optional(grad_db), grad_pos, stream
        )
    return grad_pos


@_rasterize_backward.register_fake
def _(pos: Tensor, _tri: Tensor, _rast: Tensor, _grad_rast: Tensor, _grad_db: Tensor | None) -> Tensor:
    return pos.new_empty(pos.shape)


def _empty_rasters(pos: Tensor, ranges: Tensor | None, height: int, width: int) -> tuple[Tensor, Tensor]:
    shape = (pos.shape[0] if ranges is None else ranges.shape[0], height, width, 4)
    return pos.new_empty(shape), pos.new_empty(shape)


def _setup_rasterize(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(inputs[0], inputs[1], output[0])


def _backward_rasterize(ctx: Any, grad_rast: Tensor | None, grad_db: Tensor | None) -> tuple[Tensor | None, ...]:
    pos, tri, rast = ctx.saved_tensors
    grad_pos = None
    if ctx.needs_input_grad[0] and not (grad_rast is None and grad_db is None):
        grad_rast = torch.zeros_like(rast) if grad_rast is None else grad_rast
        grad_pos = _rasterize_backward(pos, tri, rast, grad_rast, grad_db)
    return grad_pos, None, None, None, None, None, None


_rasterize.register_autograd(_backward_rasterize, setup_context=_setup_rasterize)


# ---- interpolate ----


@torch.library.custom_op(
    "mipbake::interpolate",
    mutates_args=(),
    schema="(Tensor attr, Tensor rast, Tensor tri, Tensor? rast_db, SymInt[] diff_attrs) -> (Tensor, Tensor)",
)
def _interpolate(
    attr: Tensor, rast: Tensor, tri: Tensor, rast_db: Tensor | None, diff_attrs: Sequence[int]
) -> tuple[Tensor, Tensor]:
    from mipbake import _native

    out, out_da = _empty_attributes(attr, rast, diff_attrs)
    attr, rast, tri, rast_db = _plain(attr), _plain(rast), _plain(tri), _optional(rast_db)
    with _errors_of_data(), current_stream(attr, "attr") as stream:
        _device.check(tri, attr.shape[-2], rast=rast)
        if out.numel():
            derivatives = out_da if diff_attrs else None
            _native.interpolate(attr, rast, tri, rast_db, list(diff_attrs), out, derivatives, stream)
    return out, out_da


@_interpolate.register_fake
def _(
    attr: Tensor, rast: Tensor, _tri: Tensor, _rast_db: Tensor | None, diff_attrs: Sequence[int]
) -> tuple[Tensor, Tensor]:
    return _empty_attributes(attr, rast, diff_attrs)


@torch.library.custom_op(
    "mipbake::interpolate_backward",
    mutates_args=(),
    schema="(Tensor attr, Tensor rast, Tensor tri, Tensor? rast_db, SymInt[] diff_attrs, Tensor grad_out, "
    "Tensor? grad_da, bool need_attr, bool need_rast, bool need_db) -> Tensor[]",
)
def _interpolate_backward(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None,
    diff_attrs: Sequence[int],
    grad_out: Tensor,
    grad_da: Tensor | None,
    need_attr: bool,
    need_rast: bool,
    need_db: bool,
) -> list[Tensor]:
    """The gradients that are needed, in the order of the arguments."""
    from mipbake import _native

    grad_attr, grad_rast, grad_db = every = _empty_gradients((attr, need_attr), (rast, need_rast), (rast, need_db))
    gradients = [each for each in every if each is not None]
    if grad_out.numel() == 0 or tri.shape[0] == 0:
        return [gradient.zero_() for gradient in gradients]
    attr, rast, tri, rast_db = _plain(attr), _plain(rast), _plain(tri), _optional(rast_db)
    grad_out, grad_da, selected = _plain(grad_out), _optional(grad_da), list(diff_attrs)
    with _errors_of_data(), current_stream(attr, "attr") as stream:
        _native.interpolate_backward(
            attr, rast, tri, rast_db, selected, grad_out, grad_da, grad_attr, grad_rast, grad_db, stream
        )
    return gradients


@_interpolate_backward.register_fake
def _(attr: Tensor, rast: Tensor, *rest: Any) -> list[Tensor]:
    need_attr, need_rast, need_db = rest[-3:]
    every = _empty_gradients((attr, need_attr), (rast, need_rast), (rast, need_db))
    return [each for each in every if each is not None]


def _empty_attributes(attr: Tensor, rast: Tensor, diff_attrs: Sequence[int]) -> tuple[Tensor, Tensor]:
    image = rast.shape[:3]
    return attr.new_empty((*image, attr.shape[-1])), attr.new_empty((*image, 2 * len(diff_attrs)))


def _empty_gradients(*likes: tuple[Tensor, bool]) -> list[Tensor | None]:
    """Where gradients are written, None where none is needed."""
    return [like.new_empty(like.shape) if needed else None for like, needed in likes]


def _setup_interpolate(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:  # noqa: ARG001
    ctx.set_materialize_grads(False)
    *tensors, ctx.diff_attrs = inputs
    ctx.save_for_backward(*tensors)


def _backward_interpolate(ctx: Any, grad_out: Tensor | None, grad_da: Tensor | None) -> tuple[Tensor | None, ...]:
    attr, rast, tri, rast_db = ctx.saved_tensors
    need_attr, need_rast, _, need_db, _ = ctx.needs_input_grad
    need_db = need_db and grad_da is not None
    if grad_out is None and grad_da is None:
        return None, None, None, None, None
    if grad_out is None:
        grad_out = attr.new_zeros((*rast.shape[:3], attr.shape[-1]))
    gradients = iter(
        _interpolate_backward(
            attr, rast, tri, rast_db, ctx.diff_attrs, grad_out, grad_da, need_attr, need_rast, need_db
        )
    )
    grad_attr, grad_rast, grad_db = (next(gradients) if need else None for need in (need_attr, need_rast, need_db))
    return grad_attr, grad_rast, None, grad_db, None


_interpolate.register_autograd(_backward_interpolate, setup_context=_setup_interpolate)


# ---- antialias ----


@torch.library.custom_op("mipbake::antialias_topology", mutates_args=())
def _topology(tri: Tensor, vertices: int) -> Tensor:
    """`Topology.next` of tri; `vertices` is -1 where they are not known."""
    with _errors_of_data():
        return _device.topology(_plain(tri), None if vertices < 0 else vertices)


@_topology.register_fake
def _(tri: Tensor, _vertices: int) -> Tensor:
    return tri.new_empty(tri.shape)


@torch.library.custom_op("mipbake::antialias", mutates_args=())
def _antialias(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, following: Tensor, boost: float) -> Tensor:  # noqa: ARG001
    from mipbake import _native

    out = color.new_empty(color.shape)
    color, rast, pos, tri = _plain(color), _plain(rast), _plain(pos), _plain(tri)
    with _errors_of_data(), current_stream(color, "color") as stream:
        _device.check(tri, pos.shape[-2], pos=pos, rast=rast)
        if out.numel():
            _native.antialias(color, rast, pos, tri, _plain(following), out, _silhouette_scratch(pos, tri), stream)
    return out


@_antialias.register_fake
def _(color: Tensor, *_rest: Any) -> Tensor:
    return color.new_empty(color.shape)


@torch.library.custom_op("mipbake::antialias_backward", mutates_args=())
def _antialias_backward(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    following: Tensor,
    grad: Tensor,
    boost: float,
    need_color: bool,
    need_pos: bool,
) -> list[Tensor]:
    """The gradients that are needed, of color and of pos."""
    from mipbake import _native

    grad_color, grad_pos = every = _empty_gradients((color, need_color), (pos, need_pos))
    gradients = [each for each in every if each is not None]
    if grad.numel() == 0:
        return [gradient.zero_() for gradient in gradients]
    scratch = _silhouette_scratch(pos, tri)
    color, rast, pos, tri, grad = _plain(color), _plain(rast), _plain(pos), _plain(tri), _plain(grad)
    with _errors_of_data(), current_stream(color, "color") as stream:
        _native.antialias_backward(
            color, rast, pos, tri, _plain(following), grad, boost, grad_color, grad_pos, scratch, stream
        )
    return gradients


@_antialias_backward.register_fake
def _(color: Tensor, _rast: Tensor, pos: Tensor, *rest: Any) -> list[Tensor]:
    need_color, need_pos = rest[-2:]
    return [each for each in _empty_gradients((color, need_color), (pos, need_pos)) if each is not None]


def _silhouette_scratch(pos: Tensor, tri: Tensor) -> Tensor | None:
    """A byte for each triangle of each image, with CUDA; the CPU kernels have their own."""
    items = pos.shape[0] if pos.ndim == 3 else 1
    return pos.new_empty((items, tri.shape[0]), dtype=torch.uint8) if pos.is_cuda else None


def _setup_antialias(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:  # noqa: ARG001
    *tensors, ctx.boost = inputs
    ctx.save_for_backward(*tensors)


def _backward_antialias(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
    need_color, _, need_pos = ctx.needs_input_grad[:3]
    gradients = iter(_antialias_backward(*ctx.saved_tensors, grad, ctx.boost, need_color, need_pos))
    grad_color, grad_pos = (next(gradients) if need else None for need in (need_color, need_pos))
    return grad_color, None, grad_pos, None, None, None


_antialias.register_autograd(_backward_antialias, setup_context=_setup_antialias)
