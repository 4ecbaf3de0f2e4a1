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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from mipbake.material import (
    FACTS,
    LEAST_STRENGTH,
    MAX_LOG_ALPHA2,
    MAX_LOG_GAMMA,
    MIN_HEIGHT,
    MIN_LOG_ALPHA2,
    MIN_ROUGHNESS,
    Kind,
    Lines,
    MaterialModel,
    directions,
    model_named,
    unknown,
)
from mipbake.material.directions import Wrap


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


def to_coordinates(stored: Tensor, kind: Kind) -> Tensor:
    """(..., C) valid stored channels of a map to what stands for them without constraints, as `FACTS` counts them.

    Roughness is raised to MIN_ROUGHNESS, strength to LEAST_STRENGTH.
    """
    match kind:
        case Kind.ROUGHNESS:
            out = 4 * stored.clamp(MIN_ROUGHNESS, 1).log()
        case Kind.NORMAL:
            out = stored[..., :2]
        case Kind.STRENGTH:
            out = stored.clamp(LEAST_STRENGTH, 1).square()
        case Kind.REFLECTANCE | Kind.SHARE | Kind.NORMAL_XY | Kind.DIRECTION | Kind.LOG_TENSOR | Kind.LOG_GAMMA:
            out = stored
        case _:
            unknown(kind)
    return out


def of_coordinates(coordinates: Tensor, kind: Kind, least_alpha2: float) -> Tensor:
    """Any numbers to (..., C) valid stored channels of a map, differentiable; the inverse of `to_coordinates`."""
    match kind:
        case Kind.REFLECTANCE | Kind.SHARE:
            out = clamp(coordinates, 0, 1)
        case Kind.ROUGHNESS:
            out = (clamp(coordinates, MIN_LOG_ALPHA2, 0) / 4).exp()
        case Kind.NORMAL:
            xy = _onto_disc(coordinates)
            out = torch.cat([xy, (1 - xy.square().sum(-1, keepdim=True)).clamp(min=MIN_HEIGHT**2).sqrt()], -1)
        case Kind.NORMAL_XY:
            out = _onto_disc(coordinates)
        case Kind.DIRECTION:
            out = coordinates / coordinates.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
        case Kind.STRENGTH:
            out = clamp(coordinates, LEAST_STRENGTH**2, 1).sqrt()
        case Kind.LOG_TENSOR:
            out = _within(coordinates, math.log(least_alpha2))
        case Kind.LOG_GAMMA:
            out = clamp(coordinates, -MAX_LOG_GAMMA, MAX_LOG_GAMMA)
        case _:
            unknown(kind)
    return out


def to_parameters(stored: Tensor, model: str) -> Tensor:
    """(..., C) valid stored channels to (..., P) parameters. Roughness is raised to MIN_ROUGHNESS."""
    layout = model_named(model)
    if all(FACTS[part.kind].as_stored for part in layout.parts):
        return stored
    out: list[Tensor] = []
    for part in layout.parts:
        if layout.lines is None or part.kind not in _LOBE:
            out.append(to_coordinates(stored[..., part.channels], part.kind))
        elif part.kind is Kind.DIRECTION:
            out.append(_log_tensor(stored, layout.lines))
    return torch.cat(out, -1)


def to_stored(parameters: Tensor, model: str) -> Tensor:
    """(..., P) unconstrained parameters to (..., C) valid stored channels, differentiable."""
    layout = model_named(model)
    out: list[Tensor] = []
    lobe: dict[Kind, Tensor] = {}
    for part in layout.parts:
        if part.kind is Kind.DIRECTION:
            lobe = _lobe(parameters[..., part.parameters])
    for part in layout.parts:
        if part.kind in lobe:
            out.append(lobe[part.kind])
        else:
            out.append(of_coordinates(parameters[..., part.parameters], part.kind, layout.least_alpha2))
    return torch.cat(out, -1)


_LOBE = (Kind.ROUGHNESS, Kind.DIRECTION, Kind.STRENGTH)
"""What a, b, c stand for, together, in a model that stores directions."""


def _log_tensor(stored: Tensor, lines: Lines) -> Tensor:
    """(..., 3) a, b, c of the log-roughness tensor of a model that stores directions."""
    alpha = stored[..., lines.roughness].clamp(MIN_ROUGHNESS, 1).square()
    x, y = (stored[..., lines.direction][..., i : i + 1] for i in (0, 1))
    along, across = 2 * (alpha + (1 - alpha) * stored[..., lines.strength].square()).log(), 2 * alpha.log()
    mean, half = (along + across) / 2, (along - across) / 2
    d, c = half * (x * x - y * y), half * 2 * x * y
    return torch.cat([mean + d, mean - d, c], -1)


def _parts(log_tensor: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Half of the trace, d, c, and half of what the eigenvalues differ by, which is never 0; (...) of (..., 3) each."""
    a, b, c = log_tensor.unbind(-1)
    mean, d = (a + b) / 2, (a - b) / 2
    return mean, d, c, (d * d + c * c + 1e-12).sqrt()


def _lobe(log_tensor: Tensor) -> dict[Kind, Tensor]:
    """Both roughnesses from the eigenvalues of the tensor, and the direction from the axis of the larger eigenvalue.

    Strength and direction have no derivative at isotropy, but what is shaded has: tiny amounts are added, so that the
    factors which grow there stay finite, and meet those which vanish.
    """
    mean, d, c, radius = _parts(log_tensor)
    wide, narrow = (clamp(mean + s * radius, MIN_LOG_ALPHA2, 0) for s in (1, -1))
    alpha = (narrow / 2).exp()
    strength = (((wide / 2).exp() - alpha) / (1 - alpha).clamp(min=1e-3) + 1e-8).sqrt()
    angle = torch.atan2(c, torch.where(d * d + c * c < 1e-12, 1e-6, d)) / 2
    return {
        Kind.ROUGHNESS: (narrow / 4).exp()[..., None],
        Kind.DIRECTION: torch.stack([angle.cos(), angle.sin()], -1),
        Kind.STRENGTH: strength[..., None],
    }


@dataclass(frozen=True)
class Agreement:
    """What makes directions agree, constants to the gradient.

    Args:
        signs: (B, H_L, W_L) of each level, 1 or -1. shares: (B, H_L, W_L) of each level, of the anisotropy that texels
            keep, from 0 to 1; None for a level that keeps all of it.
    """

    signs: Sequence[Tensor]
    shares: Sequence[Tensor | None]


Finder = Callable[[list[Tensor], MaterialModel, Wrap], Agreement]
"""Finds the agreement of (B, H_L, W_L, C) levels of a model that stores directions."""


def agreement(levels: list[Tensor], model: MaterialModel, wrap: Wrap) -> Agreement:
    """By `mipbake.material.directions`, on the processor."""
    lines = model.lines
    assert lines is not None
    found = [level[..., lines.channels].detach().cpu().numpy() for level in levels]
    signs = directions.signs(found, wrap)
    shares = directions.shares([each[..., :2] * s[..., None] for each, s in zip(found, signs, strict=True)], wrap)
    there = levels[0].device
    return Agreement(
        [torch.from_numpy(each).to(there) for each in signs],
        [None if (each == 1).all() else torch.from_numpy(each).to(there) for each in shares],
    )


_FINDER: ContextVar[Finder] = ContextVar("finder", default=agreement)


@contextmanager
def agreements_by(finder: Finder) -> Iterator[None]:
    """Inside, `agreeing` takes what a finder finds: a training on a graphics card finds it apart."""
    before = _FINDER.set(finder)
    try:
        yield
    finally:
        _FINDER.reset(before)


def agreeing(levels: list[Tensor], model: str, wrap: Wrap) -> list[Tensor]:
    """`mipbake.material.directions.agreeing` of (B, H_L, W_L, C) levels; signs and shares are constants.

    Differentiable: the gradients of roughness and strength meet along cuts, and are their own elsewhere.
    """
    layout = model_named(model)
    if layout.lines is None:
        return levels
    found = _FINDER.get()(levels, layout, wrap)
    return [_eased(*each, layout) for each in zip(levels, found.signs, found.shares, strict=True)]


def _eased(level: Tensor, sign: Tensor, share: Tensor | None, layout: MaterialModel) -> Tensor:
    """(B, H, W, C) with other signs, and a share of the anisotropy where it is below 1."""
    lines = layout.lines
    assert lines is not None
    direction = level[..., lines.direction] * sign[..., None]
    if share is None:
        return _with(level, layout, {Kind.DIRECTION: direction})
    kept = share[..., None]
    roughness, strength = level[..., lines.roughness], level[..., lines.strength]
    across = roughness.clamp(min=MIN_ROUGHNESS).square()
    along = across + (1 - across) * strength.square()
    middle, half = (along * across).log() / 2, (along / across).log() / 2 * kept
    narrow, wide = (middle - half).exp(), (middle + half).exp()
    # A root has no derivative at zero, where a round lobe is.
    less = ((wide - narrow) / (1 - narrow).clamp(min=1e-3)).clamp(min=1e-8).sqrt().clamp(max=1)
    roughness = torch.where(kept < 1, narrow.sqrt(), roughness)
    strength = torch.where(kept < 1, less, strength)
    return _with(level, layout, {Kind.ROUGHNESS: roughness, Kind.DIRECTION: direction, Kind.STRENGTH: strength})


def _with(level: Tensor, layout: MaterialModel, changed: Mapping[Kind, Tensor]) -> Tensor:
    """(..., C) with other channels of some kinds."""
    return torch.cat([changed.get(part.kind, level[..., part.channels]) for part in layout.parts], -1)


def _within(log_tensor: Tensor, least: float) -> Tensor:
    """(..., 3) a, b, c whose eigenvalues lie between `least` and MAX_LOG_ALPHA2."""
    mean, d, c, radius = _parts(log_tensor)
    high = clamp(mean + radius, least, MAX_LOG_ALPHA2)
    low = clamp(mean - radius, least, MAX_LOG_ALPHA2)
    mean, shrink = (high + low) / 2, (high - low) / (2 * radius)
    return torch.stack([mean + shrink * d, mean - shrink * d, shrink * c], -1)


def _onto_disc(xy: Tensor) -> Tensor:
    """(..., 2): scaled back onto the unit disc where it lies outside."""
    return xy * xy.square().sum(-1, keepdim=True).clamp(min=1).rsqrt()
