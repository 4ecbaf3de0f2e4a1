"""Shading as a torch op: differentiable in the material, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from mipbake.base.aligned import aligned, check_dense
from mipbake.base.errors import UsageError
from mipbake.base.forward_mode import refuse_tangents
from mipbake.base.stream import current_stream
from mipbake.material import model_named
from mipbake.shading._arguments import TurnedAway, batch_shape, is_black, per_texel

__all__ = ["shade"]


def shade(model: str, material: Tensor, light: Tensor, view: Tensor, *, turned_away: TurnedAway = "clamp") -> Tensor:
    """Radiance of every texel under every light-view pair; `mipbake.shading.shade` with a gradient to the material.

    Args:
        model: a name in `mipbake.material.MODELS`.
        material: (N, C) or (B, N, C) stored channels, float32 or float64 (CUDA: float32), any strides, read without a
            copy.
        light: (K, 3) or (B, K, 3) unit vectors, or (B, K, N, 3) for vectors of each texel; an axis of size 1 or stride
            0 repeats; on the material's device; converted to its dtype.
        view: the same.
        turned_away: as in `mipbake.shading.shade`.

    A batch axis of size 1, or none, repeats for every item of the others.

    Returns:
        (K, N, 3), or (B, K, N, 3) where any argument has a batch axis.

    The gradient by the material is exact, and 0 where a texel is unlit, in a roughness below its floor and in a normal
    or direction shorter than 1e-6. The gradient of an n.v that is held is 0; n.h keeps its own. Nothing is stored for
    it: the backward pass shades again (Kemppinen et al. 2023, section 3.3). Each texel's sum runs over the pairs in
    order: the same bits whatever the number of threads. Lights and views get no gradient: one that requires it is an
    error, and detach() says that none is wanted. There is no second derivative.

    Raises:
        UsageError: an unknown model or rule, or an argument whose type, dtype, device or shape does not fit, by name.
    """
    _check_tensor("material", material)
    black = is_black(turned_away)
    if material.dtype not in (torch.float32, torch.float64):
        raise UsageError(f"material is {material.dtype}: expected float32 or float64")
    device = material.device.type
    if device not in ("cpu", "cuda", "meta") or (device == "cuda" and material.dtype != torch.float32):
        raise UsageError(
            f"material is {material.dtype} on {material.device}: "
            "expected float32 on the CPU or with CUDA, or float64 on the CPU"
        )
    refuse_tangents(material=material, light=light, view=view)
    light, view = _direction("light", light, material), _direction("view", view, material)
    batch, _, N = batch_shape(model_named(model).channels, material.shape, light.shape, view.shape)
    B = 1 if batch is None else batch
    each = N if per_texel(light.shape, view.shape) else None
    out: Tensor = _shade(
        model, material.expand(B, N, material.shape[-1]), _expanded(light, B, each), _expanded(view, B, each), black
    )
    return out[0] if batch is None else out


def _expanded(directions: Tensor, B: int, N: int | None) -> Tensor:
    """(B, K, N, 3), or (B, K, 3) where N is None, of (K, 3), (B or 1, K, 3) or (B or 1, K, N or 1, 3)."""
    if N is None:
        shared = directions[:, :, 0] if directions.ndim == 4 else directions
        return shared.expand(B, *shared.shape[-2:])
    each = directions if directions.ndim == 4 else directions.unsqueeze(-2)
    return each.expand(B, each.shape[-3], N, 3)


def _check_tensor(name: str, tensor: Any) -> None:
    if not isinstance(tensor, Tensor):
        raise UsageError(f"{name} is a {type(tensor).__name__}: expected a torch tensor")
    check_dense(name, tensor)


def _direction(name: str, tensor: Tensor, material: Tensor) -> Tensor:
    _check_tensor(name, tensor)
    if tensor.is_complex() or tensor.dtype == torch.bool:
        raise UsageError(f"{name} is {tensor.dtype}: expected real numbers")
    if tensor.device != material.device:
        raise UsageError(f"{name} is on {tensor.device}: expected {material.device}, where the material is")
    if tensor.requires_grad and torch.is_grad_enabled():
        raise UsageError(f"{name} requires a gradient, and shade has none for it: pass {name}.detach()")
    return tensor.to(material.dtype)


@torch.library.custom_op("mipbake::shade", mutates_args=())
def _shade(model: str, material: Tensor, light: Tensor, view: Tensor, black: bool = False) -> Tensor:
    from mipbake import _native

    out = material.new_empty((material.shape[0], light.shape[1], material.shape[1], 3))
    if out.numel():
        with current_stream(material, "material") as stream:
            material, light, view = (aligned(tensor.detach()) for tensor in (material, light, view))
            _native.shade(model, material, light, view, out, stream, black)
    return out


@_shade.register_fake
def _(_model: str, material: Tensor, light: Tensor, _view: Tensor, _black: bool = False) -> Tensor:
    return material.new_empty((material.shape[0], light.shape[1], material.shape[1], 3))


@torch.library.custom_op("mipbake::shade_backward", mutates_args=())
def _shade_backward(
    model: str, material: Tensor, light: Tensor, view: Tensor, grad: Tensor, black: bool = False
) -> Tensor:
    from mipbake import _native

    out = material.new_empty(material.shape)
    if grad.numel() == 0:
        return out.zero_()
    with current_stream(material, "material") as stream:
        material, light, view = (aligned(tensor.detach()) for tensor in (material, light, view))
        flowing = aligned(grad.detach().contiguous())
        _native.shade_backward(model, material, light, view, flowing, out, stream, black=black)
    return out


@_shade_backward.register_fake
def _(_model: str, material: Tensor, _light: Tensor, _view: Tensor, _grad: Tensor, _black: bool = False) -> Tensor:
    return material.new_empty(material.shape)


def _setup_context(ctx: Any, inputs: tuple[str, Tensor, Tensor, Tensor, bool], output: Tensor) -> None:  # noqa: ARG001
    ctx.model, *tensors, ctx.black = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor | None, None, None, None]:
    material, light, view = ctx.saved_tensors
    needed = ctx.needs_input_grad[1]
    by_material = _shade_backward(ctx.model, material, light, view, grad, ctx.black) if needed else None
    return None, by_material, None, None, None


_shade.register_autograd(_backward, setup_context=_setup_context)
