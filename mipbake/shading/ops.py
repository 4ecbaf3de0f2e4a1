"""Shading as a torch op: gradients by material, lights and views, under torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from mipbake.base.first_order import refuse_second_derivatives
from mipbake.shading import _forward

__all__ = ["shade", "shade_backward"]

_ARGUMENTS = "str model, Tensor material, Tensor light, Tensor view"

shade = torch.library.custom_op(
    "mipbake::shade", _forward.shade, mutates_args=(), schema=f"({_ARGUMENTS}, bool black=False) -> Tensor"
)


@shade.register_fake
def _(_model: str, material: Tensor, light: Tensor, _view: Tensor, _black: bool = False) -> Tensor:
    out: Tensor = _forward.empty_radiance(material, light)
    return out


shade_backward = torch.library.custom_op(
    "mipbake::shade_backward",
    _forward.shade_backward,
    mutates_args=(),
    schema=f"({_ARGUMENTS}, Tensor grad, bool black=False) -> Tensor",
)


@shade_backward.register_fake
def _(_model: str, material: Tensor, *_rest: Any) -> Tensor:
    return material.new_empty(material.shape)


_directions_backward = torch.library.custom_op(
    "mipbake::shade_directions_backward",
    _forward.directions_backward,
    mutates_args=(),
    schema=f"({_ARGUMENTS}, Tensor grad, bool black=False) -> (Tensor, Tensor)",
)


@_directions_backward.register_fake
def _(_model: str, material: Tensor, light: Tensor, view: Tensor, *_rest: Any) -> tuple[Tensor, Tensor]:
    return material.new_empty(light.shape), material.new_empty(view.shape)


def _setup_context(ctx: Any, inputs: tuple[str, Tensor, Tensor, Tensor, bool], output: Tensor) -> None:  # noqa: ARG001
    ctx.model, *tensors, ctx.black = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
    given = (ctx.model, *ctx.saved_tensors, grad, ctx.black)
    _, by_material, *by_directions, _ = ctx.needs_input_grad
    material = shade_backward(*given) if by_material else None
    light, view = _directions_backward(*given) if any(by_directions) else (None, None)
    return None, material, light, view, None


shade.register_autograd(_backward, setup_context=_setup_context)
refuse_second_derivatives(shade_backward, "shade")
refuse_second_derivatives(_directions_backward, "shade")
