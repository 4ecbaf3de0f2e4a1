"""Stored channels to unconstrained optimisation parameters and back, in torch.

What a shader reads is constrained (colours in [0, 1], unit normals); what a network outputs is not. In between:

| model | stored channels | parameters |
|---|---|---|
| `gltf` | base colour 3, metallic, roughness r, normal x, y, z | base colour 3, metallic, 4 ln r, normal x, y |
| `ggx` | albedo 3, F0 3, normal x, y, log-roughness tensor a, b, c | the same 11 |
| `beckmann` | those of `ggx`, g = ln(gamma) | the same 12 |

4 ln r = ln alpha^2 is what the log-roughness tensor (equation 6 of Kemppinen et al. 2023) holds on its diagonal for an
isotropic material. Normals drop their height and are lifted again, normalised first when outside the disc (section
3.4). Colours are clamped and not squashed: a sigmoid or softplus reaches neither 0 nor 1, and the black albedo of a
metal is 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from mipbake.material import MAX_LOG_GAMMA, MIN_ROUGHNESS, least_alpha2

MIN_HEIGHT = 0.01
"""Lifted normals are no flatter than this: the derivative of sqrt(1 - r^2) has no bound."""

MIN_LOG_ALPHA2, MAX_LOG_ALPHA2 = 4 * math.log(MIN_ROUGHNESS), 2.0
"""Range of the eigenvalues of the log-roughness tensor, from the floor that shading has to beyond any rough surface.

The floor of `beckmann` is that of material.least_alpha2."""


class _Clamp(torch.autograd.Function):
    """Clamp whose gradient vanishes outside only where a descent step would lead farther outside."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, low: float, high: float) -> Tensor:
        ctx.save_for_backward(x)
        ctx.low, ctx.high = low, high
        return x.clamp(low, high)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        (x,) = ctx.saved_tensors
        grad = grads[0]
        outward = ((x < ctx.low) & (grad > 0)) | ((x > ctx.high) & (grad < 0))
        return grad.masked_fill(outward, 0), None, None


def clamp(x: Tensor, low: float, high: float) -> Tensor:
    """Clamp to [low, high], any shape; gradients that point back inside pass, so that nothing gets stuck at a limit."""
    clamped: Tensor = _Clamp.apply(x, low, high)  # type: ignore[no-untyped-call]
    return clamped


def to_parameters(stored: Tensor, model: str) -> Tensor:
    """(..., C) valid stored channels to (..., P) parameters. Roughness is raised to MIN_ROUGHNESS."""
    if model in ("ggx", "beckmann"):
        return stored
    roughness = stored[..., 4:5].clamp(MIN_ROUGHNESS, 1)
    return torch.cat([stored[..., :4], 4 * roughness.log(), stored[..., 5:7]], -1)


def to_stored(parameters: Tensor, model: str) -> Tensor:
    """(..., P) unconstrained parameters to (..., C) valid stored channels, differentiable."""
    return _TO_STORED[model](parameters)


def _gltf(parameters: Tensor) -> Tensor:
    roughness = (clamp(parameters[..., 4:5], MIN_LOG_ALPHA2, 0) / 4).exp()
    xy = _onto_disc(parameters[..., 5:7])
    z = (1 - xy.square().sum(-1, keepdim=True)).clamp(min=MIN_HEIGHT**2).sqrt()
    return torch.cat([clamp(parameters[..., :4], 0, 1), roughness, xy, z], -1)


def _ggx(parameters: Tensor, least: float = MIN_LOG_ALPHA2) -> Tensor:
    a, b, c = parameters[..., 8:11].unbind(-1)
    mean, d = (a + b) / 2, (a - b) / 2
    radius = (d * d + c * c + 1e-12).sqrt()
    high = clamp(mean + radius, least, MAX_LOG_ALPHA2)
    low = clamp(mean - radius, least, MAX_LOG_ALPHA2)
    mean, shrink = (high + low) / 2, (high - low) / (2 * radius)
    tensor = torch.stack([mean + shrink * d, mean - shrink * d, shrink * c], -1)
    return torch.cat([clamp(parameters[..., :6], 0, 1), _onto_disc(parameters[..., 6:8]), tensor], -1)


def _beckmann(parameters: Tensor) -> Tensor:
    g = clamp(parameters[..., 11:], -MAX_LOG_GAMMA, MAX_LOG_GAMMA)
    return torch.cat([_ggx(parameters[..., :11], math.log(least_alpha2("beckmann"))), g], -1)


def _onto_disc(xy: Tensor) -> Tensor:
    """(..., 2): scaled back onto the unit disc where it lies outside."""
    return xy * xy.square().sum(-1, keepdim=True).clamp(min=1).rsqrt()


_TO_STORED: dict[str, Callable[[Tensor], Tensor]] = {"gltf": _gltf, "ggx": _ggx, "beckmann": _beckmann}
