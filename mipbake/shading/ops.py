"""Shading as a torch op: differentiable in the material, compiled by torch.compile, on the CPU and with CUDA."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from mipbake.shading import _forward

__all__ = ["shade"]

_ARGUMENTS = "str model, Tensor material, Tensor light, Tensor view"

shade = torch.library.custom_op(
    "mipbake::shade", _forward.shade, mutates_args=(), schema=f"({_ARGUMENTS}, bool black=False) -> Tensor"
)


@shade.register_fake
def _(_model: str, material: Tensor, light: Tensor, _view: Tensor, _black: bool = False) -> Tensor:
    out: Tensor = _forward.empty_radiance(material, light)
    return out


_shade_backward = torch.library.custom_op(
    "mipbake::shade_backward",
    _forward.shade_backward,
    mutates_args=(),
    schema=f"({_ARGUMENTS}, Tensor grad, bool black=False) -> Tensor",
)


@_shade_backward.register_fake
def _(_model: str, material: Tensor, *_rest: Any) -> Tensor:
    return material.new_empty(material.shape)


def _setup_context(ctx: Any, inputs: tuple[str, Tensor, Tensor, Tensor, bool], output: Tensor) -> None:  # noqa: ARG001
    ctx.model, *tensors, ctx.black = inputs
    ctx.save_for_backward(*tensors)


def _backward(ctx: Any, grad: Tensor) -> tuple[None, Tensor | None, None, None, None]:
    material, light, view = ctx.saved_tensors
    needed = ctx.needs_input_grad[1]
    by_material = _shade_backward(ctx.model, material, light, view, grad, ctx.black) if needed else None
    return None, by_material, None, None, None


shade.register_autograd(_backward, setup_context=_setup_context)
