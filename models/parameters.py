"""Stored channels to unconstrained optimisation parameters and back, in torch.

What a shader reads is constrained (colours in [0, 1], unit normals); what a network outputs is not. In between:

| model | stored channels | parameters |
|---|---|---|
| `gltf` | base colour 3, metallic, roughness r, normal x, y, z | base colour 3, metallic, 4 ln r, normal x, y |
| `gltf-anisotropic` | channels of `gltf`, direction x, y, strength | base colour 3, metallic, normal x, y, a, b, c |
| `ggx` | albedo 3, F0 3, normal x, y, log-roughness tensor a, b, c | the same 11 |
| `beckmann` | channels of `ggx`, g = ln(gamma) | the same 12 |

4 ln r = ln alpha^2 is what the log-roughness tensor (equation 6 of Kemppinen et al. 2023) holds on its diagonal for an
isotropic material. Normals drop their height and are lifted again, normalised first when outside the disc (section
3.4). Colours are clamped and not squashed: a sigmoid or softplus reaches neither 0 nor 1, and the black albedo of a
metal is 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake import directions
from mipbake.directions import Wrap
from mipbake.material import MAX_LOG_GAMMA, MIN_ROUGHNESS, least_alpha2

MIN_HEIGHT = 0.01
"""Lifted normals are no flatter than this: the derivative of sqrt(1 - r^2) has no bound."""

MIN_LOG_ALPHA2, MAX_LOG_ALPHA2 = 4 * math.log(MIN_ROUGHNESS), 2.0
"""Range of the eigenvalues of the log-roughness tensor, from the floor that shading has to beyond any rough surface.

material.least_alpha2 gives the floor of `beckmann`."""


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
    if model == "gltf-anisotropic":
        alpha, x, y = roughness.square(), stored[..., 8:9], stored[..., 9:10]
        along, across = 2 * (alpha + (1 - alpha) * stored[..., 10:].square()).log(), 2 * alpha.log()
        mean, half = (along + across) / 2, (along - across) / 2
        d, c = half * (x * x - y * y), half * 2 * x * y
        return torch.cat([stored[..., :4], stored[..., 5:7], mean + d, mean - d, c], -1)
    return torch.cat([stored[..., :4], 4 * roughness.log(), stored[..., 5:7]], -1)


def to_stored(parameters: Tensor, model: str) -> Tensor:
    """(..., P) unconstrained parameters to (..., C) valid stored channels, differentiable."""
    return _TO_STORED[model](parameters)


def _gltf(parameters: Tensor) -> Tensor:
    roughness = (clamp(parameters[..., 4:5], MIN_LOG_ALPHA2, 0) / 4).exp()
    xy = _onto_disc(parameters[..., 5:7])
    z = (1 - xy.square().sum(-1, keepdim=True)).clamp(min=MIN_HEIGHT**2).sqrt()
    return torch.cat([clamp(parameters[..., :4], 0, 1), roughness, xy, z], -1)


def _gltf_anisotropic(parameters: Tensor) -> Tensor:
    """Both roughnesses from the eigenvalues of the tensor, and the direction from the axis of the larger eigenvalue.

    Strength and direction have no derivative at isotropy, but what is shaded has: tiny amounts are added, so that the
    factors which grow there stay finite, and meet those which vanish.
    """
    a, b, c = parameters[..., 6:9].unbind(-1)
    mean, d = (a + b) / 2, (a - b) / 2
    radius = (d * d + c * c + 1e-12).sqrt()
    wide, narrow = (clamp(mean + s * radius, MIN_LOG_ALPHA2, 0) for s in (1, -1))
    alpha = (narrow / 2).exp()
    strength = (((wide / 2).exp() - alpha) / (1 - alpha).clamp(min=1e-3) + 1e-8).sqrt()
    angle = torch.atan2(c, torch.where(d * d + c * c < 1e-12, 1e-6, d)) / 2
    xy = _onto_disc(parameters[..., 4:6])
    z = (1 - xy.square().sum(-1, keepdim=True)).clamp(min=MIN_HEIGHT**2).sqrt()
    lobe = torch.stack([angle.cos(), angle.sin(), strength], -1)
    return torch.cat([clamp(parameters[..., :4], 0, 1), (narrow / 4).exp()[..., None], xy, z, lobe], -1)


def settled(levels: list[Tensor], wrap: Wrap) -> list[Tensor]:
    """`mipbake.directions.settled` of (B, H_L, W_L, 11) levels of `gltf-anisotropic`; signs and shares are constants.

    Differentiable: the gradients of roughness and strength meet along cuts, and are their own elsewhere.
    """
    found = [level[..., 8:11].detach().cpu().numpy() for level in levels]
    sign = directions.signs(found, wrap)
    share = directions.shares([each[..., :2] * s[..., None] for each, s in zip(found, sign, strict=True)], wrap)
    return [_eased(*each) for each in zip(levels, sign, share, strict=True)]


def _eased(level: Tensor, sign: NDArray[np.float32], share: NDArray[np.float32]) -> Tensor:
    """(B, H, W, 11) with other signs, and a share of the anisotropy where it is below 1."""
    direction = level[..., 8:10] * level.new_tensor(sign)[..., None]
    if (share == 1).all():
        return torch.cat([level[..., :8], direction, level[..., 10:]], -1)
    kept, roughness, strength = level.new_tensor(share)[..., None], level[..., 4:5], level[..., 10:]
    across = roughness.clamp(min=MIN_ROUGHNESS).square()
    along = across + (1 - across) * strength.square()
    middle, half = (along * across).log() / 2, (along / across).log() / 2 * kept
    narrow, wide = (middle - half).exp(), (middle + half).exp()
    # A root has no derivative at zero, where a round lobe is.
    less = ((wide - narrow) / (1 - narrow).clamp(min=1e-3)).clamp(min=1e-8).sqrt().clamp(max=1)
    roughness = torch.where(kept < 1, narrow.sqrt(), roughness)
    strength = torch.where(kept < 1, less, strength)
    return torch.cat([level[..., :4], roughness, level[..., 5:8], direction, strength], -1)


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


_TO_STORED: dict[str, Callable[[Tensor], Tensor]] = {
    "gltf": _gltf,
    "gltf-anisotropic": _gltf_anisotropic,
    "ggx": _ggx,
    "beckmann": _beckmann,
}
