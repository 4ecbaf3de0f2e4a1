"""Texture lookups as torch ops: differentiable, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mipbake.base.aligned import aligned, check_dense
from mipbake.base.errors import UsageError
from mipbake.base.forward_mode import refuse_tangents
from mipbake.base.stream import current_stream
from mipbake.sampling._arguments import (
    TextureMip,
    check_max_mip_level,
    check_texture,
    level_sizes,
    plan_texture,
)

__all__ = ["texture", "texture_construct_mip"]

_HALF_TYPES = (torch.float16, torch.bfloat16)
_DTYPES = (torch.float32, torch.float64, *_HALF_TYPES)


def texture(
    tex: Tensor,
    uv: Tensor,
    uv_da: Tensor | None = None,
    mip_level_bias: Tensor | None = None,
    mip: TextureMip | Sequence[Tensor] | None = None,
    filter_mode: str = "auto",
    boundary_mode: str | Sequence[str] = "wrap",
    max_mip_level: int | None = None,
) -> Tensor:
    """`mipbake.sampling.texture` on torch tensors."""
    _check_storage("tex", tex)
    plan = plan_texture(
        tex.shape,
        _reals("uv", uv, tex).shape,
        None if uv_da is None else _reals("uv_da", uv_da, tex).shape,
        None if mip_level_bias is None else _reals("mip_level_bias", mip_level_bias, tex).shape,
        _checked_mip(mip, tex),
        filter_mode,
        boundary_mode,
        max_mip_level,
    )
    given = mip if isinstance(mip, Sequence) else ()
    named = {f"mip[{index}]": level for index, level in enumerate(given)}
    refuse_tangents(tex=tex, uv=uv, uv_da=uv_da, mip_level_bias=mip_level_bias, **named)
    levels = [tex]
    chain = plan.levels > 1 and (mip is None or isinstance(mip, TextureMip))
    if plan.levels > 1:
        if mip is None:
            levels += _texture_mips(tex.detach(), plan.levels - 1)
        else:
            levels += list(mip.levels if isinstance(mip, TextureMip) else mip)[: plan.levels - 1]
    dtype = _compute_dtype(tex)
    chooses_level = plan.filter not in ("nearest", "linear")
    out: Tensor = _texture(
        levels,
        uv.to(dtype),
        uv_da.to(dtype) if chooses_level and uv_da is not None else None,
        mip_level_bias.to(dtype) if chooses_level and mip_level_bias is not None else None,
        plan.filter,
        *plan.boundary,
        chain,
    )
    return out


def texture_construct_mip(tex: Tensor, max_mip_level: int | None = None, cube_mode: bool = False) -> TextureMip:
    """`mipbake.sampling.texture_construct_mip` of a torch tensor."""
    _check_storage("tex", tex)
    check_texture("tex", tex.shape, cube_mode, "cube_mode to True")
    check_max_mip_level(max_mip_level)
    count = len(level_sizes(tex.shape[-3], tex.shape[-2], max_mip_level)) - 1
    return TextureMip(tuple(tex.shape), tuple(_texture_mips(tex.detach(), count)) if count else ())


# --- checks ----------------------------------------------------------------------------------------------------------


def _check_tensor(name: str, tensor: Any) -> None:
    if not isinstance(tensor, Tensor):
        raise UsageError(f"{name} is a {type(tensor).__name__}: expected a torch tensor, as tex is")
    check_dense(name, tensor)


def _check_storage(name: str, tex: Any) -> None:
    if not isinstance(tex, Tensor):
        raise UsageError(f"{name} is a {type(tex).__name__}: expected a torch tensor or a NumPy array")
    check_dense(name, tex)
    if tex.dtype not in _DTYPES:
        raise UsageError(f"{name} is {tex.dtype}: expected float32, float64, float16 or bfloat16")
    device = tex.device.type
    if device not in ("cpu", "cuda", "meta") or (device == "cuda" and tex.dtype == torch.float64):
        raise UsageError(
            f"{name} is {tex.dtype} on {tex.device}: "
            "expected float32, float16 or bfloat16 on the CPU or with CUDA, or float64 on the CPU"
        )


def _reals(name: str, tensor: Any, tex: Tensor) -> Tensor:
    _check_tensor(name, tensor)
    if tensor.is_complex() or tensor.dtype == torch.bool:
        raise UsageError(f"{name} is {tensor.dtype}: expected real numbers")
    if tensor.device != tex.device:
        raise UsageError(f"{name} is on {tensor.device}: expected {tex.device}, where tex is")
    result: Tensor = tensor
    return result


def _checked_mip(mip: Any, tex: Tensor) -> TextureMip | list[tuple[int, ...]] | None:
    if mip is None:
        return None
    if not isinstance(mip, TextureMip) and (isinstance(mip, (Tensor, str)) or not isinstance(mip, Sequence)):
        raise UsageError(
            f"mip is a {type(mip).__name__}: expected what texture_construct_mip returns, or a list of tensors"
        )
    levels = mip.levels if isinstance(mip, TextureMip) else mip
    for index, level in enumerate(levels):
        _check_tensor(f"mip[{index}]", level)
        if level.dtype != tex.dtype or level.device != tex.device:
            raise UsageError(
                f"mip[{index}] is {level.dtype} on {level.device}: expected {tex.dtype} on {tex.device}, as tex is"
            )
    return mip if isinstance(mip, TextureMip) else [tuple(level.shape) for level in levels]


# --- levels ----------------------------------------------------------------------------------------------------------


@torch.library.custom_op("mipbake::texture_mips", mutates_args=(), schema="(Tensor tex, int count) -> Tensor[]")
def _texture_mips(tex: Tensor, count: int) -> list[Tensor]:
    """The first `count` levels after `tex`, each from the one before."""
    from mipbake import _native

    levels = _empty_levels(tex, count)
    with current_stream(tex, "tex") as stream:
        finer = aligned(tex.detach().contiguous())
        for level in levels:
            _native.texture_mip(_images(finer), _images(level), stream)
            finer = level
    return levels


@_texture_mips.register_fake
def _(tex: Tensor, count: int) -> list[Tensor]:
    return _empty_levels(tex, count)


def _empty_levels(tex: Tensor, count: int) -> list[Tensor]:
    sizes = level_sizes(tex.shape[-3], tex.shape[-2], count)
    return [tex.new_empty((*tex.shape[:-3], *size, tex.shape[-1])) for size in sizes[1:]]


def _images(level: Tensor) -> Tensor:
    """A cube map's faces as images of their own."""
    return level.flatten(0, 1) if level.ndim == 5 else level


# --- lookups ---------------------------------------------------------------------------------------------------------


@torch.library.custom_op(
    "mipbake::texture",
    mutates_args=(),
    schema="(Tensor[] levels, Tensor uv, Tensor? uv_da, Tensor? bias, str filter, str boundary_u, str boundary_v, "
    "bool chain) -> Tensor",
)
def _texture(
    levels: Sequence[Tensor],
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    filter_mode: str,
    boundary_u: str,
    boundary_v: str,
    chain: bool,  # noqa: ARG001
) -> Tensor:
    """`chain`: all levels come from the first, which takes all the gradient. Shapes are the same as in `texture`."""
    from mipbake import _native

    out = _empty_result(levels, uv, uv_da, bias)
    if out.numel():
        with current_stream(uv, "tex") as stream:
            _native.texture(
                [_level(level) for level in levels],
                _flat(uv),
                None if uv_da is None else _flat(uv_da),
                None if bias is None else _flat_bias(bias, uv),
                filter_mode,
                boundary_u,
                boundary_v,
                out.flatten(1, 2),
                stream,
            )
    return out


@_texture.register_fake
def _(levels: Sequence[Tensor], uv: Tensor, uv_da: Tensor | None, bias: Tensor | None, *_modes: Any) -> Tensor:
    return _empty_result(levels, uv, uv_da, bias)


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

    need_levels, need_uv, need_uv_da, need_bias = needs
    level_grads = [grad.new_empty(level.shape) for level in levels] if need_levels else []
    batch, height, width, _ = grad.shape
    uv_grad = grad.new_empty((batch, height, width, uv.shape[-1])) if need_uv else None
    uv_da_grad = grad.new_empty((batch, height, width, 2 * uv.shape[-1])) if need_uv_da else None
    bias_grad = grad.new_empty((batch, height, width)) if need_bias else None
    lookup_grads = [g for g in (uv_grad, uv_da_grad, bias_grad) if g is not None]
    if grad.numel() == 0:
        level_grads = [g.zero_() for g in level_grads]
    else:
        with current_stream(uv, "tex") as stream:
            _native.texture_backward(
                aligned(grad.detach().contiguous()).flatten(1, 2),
                [_level(level, need_levels) for level in levels],
                _flat(uv),
                None if uv_da is None else _flat(uv_da),
                None if bias is None else _flat_bias(bias, uv),
                filter_mode,
                boundary_u,
                boundary_v,
                level_grads,
                None if uv_grad is None else uv_grad.flatten(1, 2),
                None if uv_da_grad is None else uv_da_grad.flatten(1, 2),
                None if bias_grad is None else bias_grad.flatten(1, 2),
                stream,
            )
            if chain:
                for coarser, finer in zip(level_grads[:0:-1], level_grads[-2::-1], strict=True):
                    _native.texture_mip_backward(_images(coarser), _images(finer), stream)
    if chain:
        level_grads = level_grads[:1]
    return [*(g.to(levels[0].dtype) for g in level_grads), *lookup_grads]


@_texture_backward.register_fake
def _(
    grad: Tensor, levels: Sequence[Tensor], uv: Tensor, _uv_da: Tensor | None, _bias: Tensor | None, *rest: Any
) -> list[Tensor]:
    chain, (need_levels, *needs) = rest[-2:]
    lookups, axes = grad.shape[:3], uv.shape[-1]
    shapes = ((*lookups, axes), (*lookups, 2 * axes), lookups)
    return [
        *([level.new_empty(level.shape) for level in levels[: 1 if chain else None]] if need_levels else []),
        *(grad.new_empty(shape) for shape, need in zip(shapes, needs, strict=True) if need),
    ]


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


_texture.register_autograd(_backward, setup_context=_setup_context)


def _compute_dtype(tex: Tensor) -> torch.dtype:
    return torch.float32 if tex.dtype in _HALF_TYPES else tex.dtype


def _empty_result(levels: Sequence[Tensor], uv: Tensor, uv_da: Tensor | None, bias: Tensor | None) -> Tensor:
    batch = uv.shape[0]
    for tensor in (levels[0], uv_da, bias):
        if tensor is not None and batch == 1:
            batch = tensor.shape[0]
    return uv.new_empty((batch, *uv.shape[1:3], levels[0].shape[-1]))


def _level(level: Tensor, own_items: bool = False) -> Tensor:
    """The level itself, or a copy where its channels do not lie side by side, or its items in the same place."""
    level = level.detach()
    shares = own_items and level.shape[0] > 1 and level.stride(0) == 0
    return aligned(level if (level.stride(-1) == 1 or level.shape[-1] == 1) and not shares else level.contiguous())


def _flat(lookups: Tensor) -> Tensor:
    """(B | 1, h, w, n) to (B | 1, P, n), contiguous; one item where all repeat it."""
    lookups = lookups.detach()
    repeats = lookups.shape[0] > 1 and lookups.stride(0) == 0
    return aligned((lookups[:1] if repeats else lookups).contiguous()).flatten(1, 2)


def _flat_bias(bias: Tensor, uv: Tensor) -> Tensor:
    """(B | 1, h | 1, w | 1) to (B | 1, P), or to (B | 1, 1) where it is the same for all lookups of an item."""
    bias = bias.detach()
    if bias.shape[1:] != (1, 1):
        bias = bias.expand(-1, *uv.shape[1:3])
    return aligned(bias.contiguous()).flatten(1)


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
