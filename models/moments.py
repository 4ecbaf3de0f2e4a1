"""What can be averaged exactly: moments of the stored channels of a material model.

Averages of these quantities over a pixel are what closed forms are made of: the stored channels (`linear`), slopes and
their squares (`lean`), the length of the mean normal (`toksvig`, `unreal`). A network that is given them need not learn
them, and what it predicts can be expressed in them (moment_statistics.py).

Two more weigh every texel by how bright it gets: by the height of its lobe, 1 / sqrt(det S), and by the lobe's value
where light and view mirror each other on the flat surface, 1 / sqrt(det S) / (1 + s^T S^-1 s)^2 for a slope s. Of a
round lobe they are 1 / alpha^2 and alpha^2 / (alpha^2 + |s|^2)^2. Flat gloss between steep joints is seen as a sharp
highlight that hardly knows of the joints: its mean slope among all texels is off by more than the highlight is wide,
among bright texels it is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from mipbake.material import Kind, MaterialModel
from mipbake.models import surface
from mipbake.models.channels import (
    Having,
    channels,
    count,
    every,
    has_log_gamma,
    has_metallic,
    has_specular,
    has_tensor,
    places,
)

T = TypeVar("T")

_MIN_HEIGHT = 0.1  # slopes are cut at 10, 84 degrees: a few steep texels would rule their variance


def least_roughness(model: MaterialModel) -> float:
    """The least roughness that is shaded."""
    return float(model.least_alpha2**0.25)


class _Texel:
    """What moments are made of, (..., n) each, of stored channels; n is 0 for what a model does not have.

    Attributes:
        base, metallic: one colour and its share of metal, 3 and 1. diffuse, specular: or two reflectances, 3 each.
        roughness: perceptual, of the round lobe, 1. stretch: of the lobe, 2 (mipbake.models.surface).
        log_gamma: 1. normal: x and y, 2.
        drop: 1 - n_z. slope: 2, cut at 10. x, y: of the slope. steepness: the sum of their squares.
        alpha2, log_roughness: of the roughness raised to what is shaded.
        tensor: half of the trace of S, half of the difference of its diagonal, and S12; 3.
        height: 1 / alpha^2, of the lobe. upward: the lobe's value upwards.
    """

    def __init__(self, stored: Tensor, model: MaterialModel) -> None:
        xy, z = torch.split(surface.unit_normals(stored, model), [2, 1], -1)
        self.normal = xy
        # 1 - n_z without cancellation: alpha^2 goes down to 4e-6, and spreads of normals are measured against it.
        self.drop = torch.where(z > 0, xy.square().sum(-1, keepdim=True) / (1 + z.clamp(min=0)), 1 - z)
        self.slope = xy / z.clamp(min=_MIN_HEIGHT)
        self.x, self.y = self.slope[..., :1], self.slope[..., 1:]
        self.roughness, self.stretch = surface.round_roughness(stored, model), surface.stretch(stored, model)
        shaded = self.roughness.clamp(min=least_roughness(model))
        self.alpha2, self.steepness = shaded**4, self.x * self.x + self.y * self.y
        self.tensor, seen = _stretched(self.alpha2, self.stretch, self.x, self.y, self.steepness)
        nothing, colours = stored[..., :0], surface.maps(stored, model, Kind.REFLECTANCE)
        self.base = colours if has_metallic(model) else nothing
        self.metallic = surface.maps(stored, model, Kind.SHARE)
        self.diffuse = colours[..., :3] if has_specular(model) else nothing
        self.specular = colours[..., 3:] if has_specular(model) else nothing
        self.log_gamma = surface.maps(stored, model, Kind.LOG_GAMMA)
        self.log_roughness = shaded.log()
        self.height, self.upward = 1 / self.alpha2, self.alpha2 / (self.alpha2 + seen).square()


def _stretched(alpha2: Tensor, stretch: Tensor, x: Tensor, y: Tensor, steepness: Tensor) -> tuple[Tensor, Tensor]:
    """The tensor (..., 3) of a lobe, and alpha^2 s^T S^-1 s: how steep a slope is to it, (..., 1). (..., 0) and the
    steepness for a round one."""
    if not stretch.shape[-1]:
        return stretch, steepness
    d, c = torch.split(stretch, 1, -1)
    q = stretch.square().sum(-1, keepdim=True).sqrt()
    cosh, sinhc = q.cosh(), torch.where(q > 1e-4, q.sinh() / q.clamp(min=1e-4), torch.ones_like(q))
    seen = cosh * steepness - sinhc * (d * (x * x - y * y) + 2 * c * x * y)
    return alpha2 * torch.cat([cosh, sinhc * d, sinhc * c], -1), seen.clamp(min=0)


def _moment(width: int, of: Callable[[_Texel], Tensor], having: Having = every) -> dict[str, Any]:
    return channels(width, having, of=of)


@dataclass(frozen=True)
class Moments(Generic[T]):
    """The moments of a texel, in the order of their channels: how many channels each has, and what it is.

    The first moments, up to `drop`, are also what sharpening goes by (moment_network.MomentNetwork.detail).
    """

    base: T = field(metadata=_moment(3, lambda texel: texel.base, has_metallic))
    metallic: T = field(metadata=_moment(1, lambda texel: texel.metallic, has_metallic))
    diffuse: T = field(metadata=_moment(3, lambda texel: texel.diffuse, has_specular))
    specular: T = field(metadata=_moment(3, lambda texel: texel.specular, has_specular))
    roughness: T = field(metadata=_moment(1, lambda texel: texel.roughness))
    stretch: T = field(metadata=_moment(2, lambda texel: texel.stretch, has_tensor))
    log_gamma: T = field(metadata=_moment(1, lambda texel: texel.log_gamma, has_log_gamma))
    normal: T = field(metadata=_moment(2, lambda texel: texel.normal))
    drop: T = field(metadata=_moment(1, lambda texel: texel.drop))
    slope: T = field(metadata=_moment(2, lambda texel: texel.slope))
    slope_xx: T = field(metadata=_moment(1, lambda texel: texel.x * texel.x))
    slope_yy: T = field(metadata=_moment(1, lambda texel: texel.y * texel.y))
    slope_xy: T = field(metadata=_moment(1, lambda texel: texel.x * texel.y))
    alpha2: T = field(metadata=_moment(1, lambda texel: texel.alpha2))
    log_roughness: T = field(metadata=_moment(1, lambda texel: texel.log_roughness))
    tensor: T = field(metadata=_moment(3, lambda texel: texel.tensor, has_tensor))
    metallic_base: T = field(metadata=_moment(3, lambda texel: texel.metallic * texel.base, has_metallic))
    metallic2: T = field(metadata=_moment(1, lambda texel: texel.metallic * texel.metallic, has_metallic))
    specular2: T = field(metadata=_moment(3, lambda texel: texel.specular * texel.specular, has_specular))
    height: T = field(metadata=_moment(1, lambda texel: texel.height))
    height_slope: T = field(metadata=_moment(2, lambda texel: texel.height * texel.slope))
    height_steepness: T = field(metadata=_moment(1, lambda texel: texel.height * texel.steepness))
    height_specular: T = field(metadata=_moment(3, lambda texel: texel.height * texel.specular, has_specular))
    upward: T = field(metadata=_moment(1, lambda texel: texel.upward))
    upward_slope: T = field(metadata=_moment(2, lambda texel: texel.upward * texel.slope))
    upward_steepness: T = field(metadata=_moment(1, lambda texel: texel.upward * texel.steepness))
    upward_alpha2: T = field(metadata=_moment(1, lambda texel: texel.upward * texel.alpha2))
    upward_specular: T = field(metadata=_moment(3, lambda texel: texel.upward * texel.specular, has_specular))


def moment_places(model: MaterialModel) -> Moments[slice]:
    """Where each moment stands among the moments of a model."""
    found: Moments[slice] = places(Moments, model)
    return found


def moment_count(model: MaterialModel) -> int:
    """Channels of the moments of a texel."""
    return count(Moments, model)


def moments(stored: Tensor, model: MaterialModel) -> Tensor:
    """(..., C) stored channels to (..., moment_count)."""
    texel = _Texel(stored, model)
    return torch.cat([each.metadata["of"](texel) for each in fields(Moments)], -1)
