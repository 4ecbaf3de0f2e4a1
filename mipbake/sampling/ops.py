"""Texture lookups as a torch op: differentiable, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from mipbake._stream import current_stream
from mipbake.errors import UsageError
from mipbake.sampling._arguments import check_level_count, result_shape, wraps

__all__ = ["sample"]


def sample(levels: Sequence[Tensor], uv: Tensor, lod: Tensor | float, wrap: Sequence[str] = ("wrap", "wrap")) -> Tensor:
    """Trilinear lookups in a MIP stack; `mipbake.sampling.sample` with gradients to every level, to uv and to lod.

    Args:
        levels: 1 to 32 tensors (H_L, W_L, C) or (B, H_L, W_L, C), the finest first, all float32 or all float64 (CUDA:
            float32), on one device. Read without a copy where the channels of a texel lie side by side; memory that
            is laid out (B, C, H, W) is copied.
        uv: (P, 2) or (B, P, 2), any real numbers; converted to the dtype of the levels.
        lod: number or scalar tensor, (P,) or (B, P); clamped to [0, len(levels) - 1]; converted likewise.
        wrap: "wrap" or "clamp" for u and v.

    A batch axis of size 1, or none, repeats for every item of the others, and its gradient is summed over them.

    Returns:
        (P, C), or (B, P, C) where any argument has a batch axis. NaN where u, v or lod is NaN, or infinite on an axis
        that wraps; such a lookup adds nothing to the gradients of texels, and its own gradients are 0.

    Gradients are those of the piecewise linear interpolant. Where it has a kink they are one-sided, towards larger u,
    v and lod: at a texel centre the slope to the next texel, at a whole lod the step to the next coarser level. They
    are 0 in u or v beyond the first and last texel centre of a clamped axis, and in lod below 0 and from the last
    level on. On the CPU each texel's gradient is summed in the order of the lookups: the same bits whatever the number
    of threads. With CUDA it is summed by atomics, and its last digits vary from run to run. There is no second
    derivative.

    Raises:
        UsageError: an argument whose type, dtype, device or shape does not fit, by name.
    """
    tensors = _levels(levels)
    first = tensors[0]
    coordinates = _like("uv", uv, first)
    detail = _like("lod", lod, first) if isinstance(lod, Tensor) else first.new_full((), _number(lod))
    wrap_u, wrap_v = wraps(wrap)
    result_shape([level.shape for level in tensors], coordinates.shape, detail.shape)
    out: Tensor = _sample(tensors, coordinates, detail, wrap_u, wrap_v)
    return out


def _levels(levels: Sequence[Tensor]) -> list[Tensor]:
    if isinstance(levels, Tensor) or not isinstance(levels, Sequence):
        raise UsageError(f"levels is a {type(levels).__name__}: expected a list of tensors, the finest level first")
    check_level_count(len(levels))
    for index, level in enumerate(levels):
        if not isinstance(level, Tensor):
            raise UsageError(f"levels[{index}] is a {type(level).__name__}: expected a torch tensor")
        if level.dtype not in (torch.float32, torch.float64) or level.dtype != levels[0].dtype:
            raise UsageError(
                f"levels[{index}] is {level.dtype}: expected float32 or float64, "
                f"the same as levels[0] ({levels[0].dtype})"
            )
        if level.device != levels[0].device:
            raise UsageError(f"levels[{index}] is on {level.device}: expected {levels[0].device}, where levels[0] is")
    device = levels[0].device.type
    if device not in ("cpu", "cuda", "meta") or (device == "cuda" and levels[0].dtype != torch.float32):
        raise UsageError(
            f"levels are {levels[0].dtype} on {levels[0].device}: "
            "expected float32 on the CPU or with CUDA, or float64 on the CPU"
        )
    return list(levels)


def _like(name: str, tensor: Tensor, levels: Tensor) -> Tensor:
    if not isinstance(tensor, Tensor):
        raise UsageError(f"{name} is a {type(tensor).__name__}: expected a torch tensor")
    if tensor.is_complex() or tensor.dtype == torch.bool:
        raise UsageError(f"{name} is {tensor.dtype}: expected real numbers")
    if tensor.device != levels.device:
        raise UsageError(f"{name} is on {tensor.device}: expected {levels.device}, where the levels are")
    return tensor.to(levels.dtype)


def _number(lod: Any) -> float:
    if isinstance(lod, bool) or not isinstance(lod, (int, float)):
        raise UsageError(f"lod is a {type(lod).__name__}: expected a number or a torch tensor")
    return float(lod)


@torch.library.custom_op(
    "mipbake::sample",
    mutates_args=(),
    schema="(Tensor[] levels, Tensor uv, Tensor lod, bool wrap_u, bool wrap_v) -> Tensor",
)
def _sample(levels: Sequence[Tensor], uv: Tensor, lod: Tensor, wrap_u: bool, wrap_v: bool) -> Tensor:
    from mipbake import _native

    out = _empty_result(levels, uv, lod)
    if out.numel() == 0:
        return out
    with current_stream(uv, "uv") as stream:
        _native.sample(
            [_level(level) for level in levels], _uv(uv), _lod(lod), wrap_u, wrap_v, _batched(out, 3), stream
        )
    return out


@_sample.register_fake
def _(levels: Sequence[Tensor], uv: Tensor, lod: Tensor, *_wrap: bool) -> Tensor:
    return _empty_result(levels, uv, lod)


@torch.library.custom_op(
    "mipbake::sample_backward",
    mutates_args=(),
    schema="(Tensor grad, Tensor[] levels, Tensor uv, Tensor lod, bool wrap_u, bool wrap_v, "
    "bool need_levels, bool need_uv, bool need_lod) -> Tensor[]",
)
def _sample_backward(
    grad: Tensor,
    levels: Sequence[Tensor],
    uv: Tensor,
    lod: Tensor,
    wrap_u: bool,
    wrap_v: bool,
    need_levels: bool,
    need_uv: bool,
    need_lod: bool,
) -> list[Tensor]:
    """The gradients that are needed, in the order of the arguments; those of uv and lod per lookup, not yet summed."""
    from mipbake import _native

    outputs = _empty_gradients(grad, levels, need_levels, need_uv, need_lod)
    if grad.numel() == 0:
        return [output.zero_() for output in outputs]
    rest = outputs[len(levels) :] if need_levels else outputs
    with current_stream(uv, "uv") as stream:
        _native.sample_backward(
            _batched(grad.detach().contiguous(), 3),
            [_level(level) for level in levels],
            _uv(uv),
            _lod(lod),
            wrap_u,
            wrap_v,
            [_batched(level, 4) for level in outputs[: len(levels)]] if need_levels else [],
            rest[0] if need_uv else None,
            rest[-1] if need_lod else None,
            stream,
        )
    return outputs


@_sample_backward.register_fake
def _(grad: Tensor, levels: Sequence[Tensor], _uv: Tensor, _lod: Tensor, *flags: bool) -> list[Tensor]:
    return _empty_gradients(grad, levels, *flags[2:])


def _setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:  # noqa: ARG001
    levels, uv, lod, ctx.wrap_u, ctx.wrap_v = inputs
    ctx.save_for_backward(*levels, uv, lod)


def _backward(ctx: Any, grad: Tensor) -> tuple[list[Tensor | None], Tensor | None, Tensor | None, None, None]:
    *levels, uv, lod = ctx.saved_tensors
    level_needs, need_uv, need_lod = ctx.needs_input_grad[:3]
    need_levels = any(level_needs)
    gradients = iter(_sample_backward(grad, levels, uv, lod, ctx.wrap_u, ctx.wrap_v, need_levels, need_uv, need_lod))
    level_grads: list[Tensor | None] = [next(gradients) if need_levels else None for _ in levels]
    return (
        [level_grad if need else None for level_grad, need in zip(level_grads, level_needs, strict=True)],
        _sum_to(next(gradients), uv.shape) if need_uv else None,
        _sum_to(next(gradients), lod.shape) if need_lod else None,
        None,
        None,
    )


_sample.register_autograd(_backward, setup_context=_setup_context)


def _empty_result(levels: Sequence[Tensor], uv: Tensor, lod: Tensor) -> Tensor:
    return uv.new_empty(result_shape([level.shape for level in levels], uv.shape, lod.shape))


def _empty_gradients(
    grad: Tensor, levels: Sequence[Tensor], need_levels: bool, need_uv: bool, need_lod: bool
) -> list[Tensor]:
    lookups = (1, *grad.shape[:-1])[-2:]
    return [
        *([level.new_empty(level.shape) for level in levels] if need_levels else []),
        *([grad.new_empty((*lookups, 2))] if need_uv else []),
        *([grad.new_empty(lookups)] if need_lod else []),
    ]


def _sum_to(grad: Tensor, shape: torch.Size) -> Tensor:
    """Sums (B, P, ...) over the axes along which an argument of that shape was repeated, in a fixed order."""
    if len(shape) == 0:
        # Two stages: torch splits the sum of a long vector among its threads, but not that of a short one or of rows.
        flat = grad.reshape(-1)
        rows = torch.nn.functional.pad(flat, (0, -flat.shape[0] % 256)).view(256, -1)
        return rows.sum(1).sum()
    batch = shape[0] if len(shape) == grad.ndim else 1
    summed = grad if batch == grad.shape[0] else grad.sum(0, keepdim=True)
    return summed.reshape(shape)


def _batched(tensor: Tensor, ndim: int) -> Tensor:
    return tensor if tensor.ndim == ndim else tensor[None]


def _level(level: Tensor) -> Tensor:
    level = _batched(level.detach(), 4)
    return level if level.stride(3) == 1 or level.shape[3] == 1 else level.contiguous()


def _uv(uv: Tensor) -> Tensor:
    return _batched(uv.detach().contiguous(), 3)


def _lod(lod: Tensor) -> Tensor:
    return lod.detach().reshape((1, 1, *lod.shape)[-2:])
