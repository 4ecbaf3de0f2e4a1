"""What can be averaged exactly: moments of the stored channels of `gltf`, and what they tell about a level's texel.

Averages of these quantities over a pixel are what closed forms are made of: the stored channels (`linear`), slopes and
their squares (`lean`), the length of the mean normal (`toksvig`, `unreal`). A network that is given them need not learn
them, and what it predicts can be expressed in them: every change that is offered here vanishes where a material is
constant, so that there the averages stay as they are, 0 and 1 included.

Two more weigh every texel by how bright it gets: by the height of its lobe, 1 / alpha^2, and by the lobe's value where
light and view mirror each other on the flat surface, alpha^2 / (alpha^2 + |slope|^2)^2. Flat gloss between steep joints
is seen as a sharp highlight that hardly knows of the joints: its mean slope among all texels is off by more than the
highlight is wide, among bright texels it is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from mipbake.material import MIN_ROUGHNESS
from mipbake.models.channels import channels, count, parts, places

T = TypeVar("T")

_MIN_ALPHA2 = MIN_ROUGHNESS**4
_MIN_LOG = math.log(MIN_ROUGHNESS)
_MIN_HEIGHT = 0.1  # slopes are cut at 10, 84 degrees: a few steep texels would rule their variance
_FARTHEST = 3.0  # standard deviations from the mean slope to the mean slope of bright texels
_SOFT = 0.05  # logarithm of roughness by which closed forms differ where half of a free change is allowed
_CANCELLED = 4e-7  # share of a square that float32 leaves where an equal square is taken from it
_ROUNDING = 2e-6  # what is left of the variance of a constant in float32
_SOFT_VARIANCE = 0.02  # variance of normals, or of metallic, where half of a change of colour is


@dataclass(frozen=True)
class _Texel:
    """What moments are made of, (..., n) each, of stored channels of `gltf`.

    Args:
        base, metallic, roughness, normal: stored channels, 3, 1, 1 and 2 (x and y).
        drop: 1 - n_z. slope: 2, cut at 10. x, y: of the slope. steepness: the sum of their squares.
        alpha2, log_roughness: of the roughness raised to MIN_ROUGHNESS.
        height: 1 / alpha^2, of the lobe. upward: the lobe's value upwards.
    """

    base: Tensor
    metallic: Tensor
    roughness: Tensor
    normal: Tensor
    drop: Tensor
    slope: Tensor
    x: Tensor
    y: Tensor
    steepness: Tensor
    alpha2: Tensor
    log_roughness: Tensor
    height: Tensor
    upward: Tensor


def _texel(stored: Tensor) -> _Texel:
    xy, z = stored[..., 5:7], stored[..., 7:8]
    # 1 - n_z without cancellation: alpha^2 goes down to 4e-6, and spreads of normals are measured against it.
    drop = torch.where(z > 0, xy.square().sum(-1, keepdim=True) / (1 + z.clamp(min=0)), 1 - z)
    slope = xy / z.clamp(min=_MIN_HEIGHT)
    x, y = slope[..., :1], slope[..., 1:]
    shaded = stored[..., 4:5].clamp(min=MIN_ROUGHNESS)
    alpha2, steepness = shaded**4, x * x + y * y
    return _Texel(
        base=stored[..., :3],
        metallic=stored[..., 3:4],
        roughness=stored[..., 4:5],
        normal=xy,
        drop=drop,
        slope=slope,
        x=x,
        y=y,
        steepness=steepness,
        alpha2=alpha2,
        log_roughness=shaded.log(),
        height=1 / alpha2,
        upward=alpha2 / (alpha2 + steepness).square(),
    )


def _moment(width: int, of: Callable[[_Texel], Tensor]) -> dict[str, Any]:
    return channels(width, of=of)


@dataclass(frozen=True)
class Moments(Generic[T]):
    """The moments of a texel, in the order of their channels: how many channels each has, and what it is.

    The first moments, up to `drop`, are also what sharpening is told by (moment_network.DETAIL).
    """

    base: T = field(metadata=_moment(3, lambda texel: texel.base))
    metallic: T = field(metadata=_moment(1, lambda texel: texel.metallic))
    roughness: T = field(metadata=_moment(1, lambda texel: texel.roughness))
    normal: T = field(metadata=_moment(2, lambda texel: texel.normal))
    drop: T = field(metadata=_moment(1, lambda texel: texel.drop))
    slope: T = field(metadata=_moment(2, lambda texel: texel.slope))
    slope_xx: T = field(metadata=_moment(1, lambda texel: texel.x * texel.x))
    slope_yy: T = field(metadata=_moment(1, lambda texel: texel.y * texel.y))
    slope_xy: T = field(metadata=_moment(1, lambda texel: texel.x * texel.y))
    alpha2: T = field(metadata=_moment(1, lambda texel: texel.alpha2))
    log_roughness: T = field(metadata=_moment(1, lambda texel: texel.log_roughness))
    metallic_base: T = field(metadata=_moment(3, lambda texel: texel.metallic * texel.base))
    metallic2: T = field(metadata=_moment(1, lambda texel: texel.metallic * texel.metallic))
    height: T = field(metadata=_moment(1, lambda texel: texel.height))
    height_slope: T = field(metadata=_moment(2, lambda texel: texel.height * texel.slope))
    height_steepness: T = field(metadata=_moment(1, lambda texel: texel.height * texel.steepness))
    upward: T = field(metadata=_moment(1, lambda texel: texel.upward))
    upward_slope: T = field(metadata=_moment(2, lambda texel: texel.upward * texel.slope))
    upward_steepness: T = field(metadata=_moment(1, lambda texel: texel.upward * texel.steepness))
    upward_alpha2: T = field(metadata=_moment(1, lambda texel: texel.upward * texel.alpha2))


COUNT = count(Moments)
"""Channels of the moments of a texel."""

PLACES: Moments[slice] = places(Moments)
"""Where each moment stands among them."""


def moments(stored: Tensor) -> Tensor:
    """(..., 8) stored channels of `gltf` to (..., COUNT)."""
    texel = _texel(stored)
    return torch.cat([each.metadata["of"](texel) for each in fields(Moments)], -1)


@dataclass(frozen=True)
class Statistics:
    """Averages of a level's texels and what follows from them; (..., n) each.

    Args:
        base, metallic, roughness: averages, 3, 1 and 1, cut to [0, 1].
        log_roughness: of the roughness that is shaded, 1.
        normal: x and y of the mean normal, normalised.
        to_lean, to_geometric, to_quartic: by how much the logarithm of roughness is greater in `lean`, for the mean of
            ln roughness, and for the mean of alpha^2; 1 each. 0 on a constant material.
        to_widened: the same for alpha'^2 = (alpha^2 + 2 v (1 - alpha^2)) / (1 + 2 v) with v = (1 - r) / r and r the
            length of the mean normal, 1. The released weights were trained with this form of `unreal`, which that rule
            had before it followed the engine: it is narrower where alpha is near 1.
        lean_normal: the normal of the mean slope minus `normal`, 2.
        spread: variance of the unit normals, 1 - |mean|^2, 1.
        metallic_variance: 1. metallic_colour: covariance of metallic and base colour, 3.
        slopes: variance of both slopes together, 1. axes: their covariance tensor's deviator over it, 2.
        to_tall, to_upward: what `to_lean` is, among bright texels by either weight, 1 each.
        to_narrowest: for the mean of 1 / alpha^2, or 0, whichever is less, 1. No lobe should be much narrower.
        tall_normal, upward_normal: the normal of the mean slope among them minus `normal`, 2 each.
        freedom: from 0 on a constant material to 1 where closed forms disagree, 1.
        tall_freedom, upward_freedom: the same among bright texels: from 0 where those are alike, 1 each.
        colour_freedom: the same for colours, from what varies beside them, 1.
    """

    base: Tensor
    metallic: Tensor
    roughness: Tensor
    log_roughness: Tensor
    normal: Tensor
    to_lean: Tensor
    to_widened: Tensor
    to_geometric: Tensor
    to_quartic: Tensor
    lean_normal: Tensor
    spread: Tensor
    metallic_variance: Tensor
    metallic_colour: Tensor
    slopes: Tensor
    axes: Tensor
    to_tall: Tensor
    to_upward: Tensor
    to_narrowest: Tensor
    tall_normal: Tensor
    upward_normal: Tensor
    freedom: Tensor
    tall_freedom: Tensor
    upward_freedom: Tensor
    colour_freedom: Tensor

    def features(self) -> Tensor:
        """(..., FEATURES): the statistics scaled to about 1, for a decoder."""
        ratio = self.slopes * (-4 * self.log_roughness).exp()
        offsets = (self.tall_normal, self.to_tall), (self.upward_normal, self.to_upward)  # in widths of the lobes
        parts = [
            4 * self.to_lean,
            4 * self.to_widened,
            4 * self.to_geometric,
            4 * self.to_quartic,
            self.log_roughness + 0.8,
            self.metallic,
            2 * self.base - 0.8,
            (self.slopes + 1e-5).log() / 4 + 1,
            (self.spread + 1e-5).log() / 4 + 1,
            2 * self.axes,
            4 * self.metallic_variance,
            4 * self.metallic_colour,
            2 * self.normal,
            4 * self.lean_normal,
            self.freedom,
            self.colour_freedom,
            (ratio + 1e-3).log() / 4,
            4 * self.to_tall,
            4 * self.to_upward,
            *(4 * normal for normal in (self.tall_normal, self.upward_normal)),
            *((normal * (-2 * (self.log_roughness + by)).exp()).asinh() / 2 for normal, by in offsets),
        ]
        return torch.cat(parts, -1)


def statistics(means: Tensor) -> Statistics:
    """Statistics of (..., COUNT) averages of `moments`. Kernels with negative lobes leave ranges; every value is cut to
    its range."""
    mean: Moments[Tensor] = parts(PLACES, means)
    base, metallic, roughness = (each.clamp(0, 1) for each in (mean.base, mean.metallic, mean.roughness))
    xy, drop, slope = mean.normal, mean.drop, mean.slope
    quartic = mean.alpha2.clamp(_MIN_ALPHA2, 1)
    length2 = xy.square().sum(-1, keepdim=True)
    spread = (2 * drop - drop * drop - length2 * (1 + _CANCELLED)).clamp(0, 1)
    height = 1 - drop
    normal = xy * (length2 + height * height).clamp(min=1e-8).rsqrt()
    x, y = slope[..., :1], slope[..., 1:]
    xx, yy, xy_ = mean.slope_xx - x * x, mean.slope_yy - y * y, mean.slope_xy - x * y
    slopes = (xx + yy - _CANCELLED * (x * x + y * y)).clamp(0, 50)
    shaded = roughness.clamp(min=MIN_ROUGHNESS)
    log_roughness = shaded.log()
    length = (1 - spread).clamp(min=1e-6).sqrt()
    concentration = (1 - length) / length
    alpha2 = shaded**4
    widened = (alpha2 + 2 * concentration * (1 - alpha2)) / (1 + 2 * concentration)
    to_lean = (quartic + slopes).clamp(max=1).log() / 4 - log_roughness
    to_widened = widened.log() / 4 - log_roughness
    to_geometric = (mean.log_roughness.clamp(_MIN_LOG, 0) - log_roughness).clamp(-2, 0.5)
    lean_normal = _leaning(slope) - normal
    # By Jensen's inequality; kernels with negative lobes break it.
    tall = torch.maximum(mean.height, 1 / quartic)
    tall_slope, tall_variance = _among(tall, mean.height_slope, mean.height_steepness, slope, slopes)
    upward = mean.upward.clamp(min=1e-4)
    upward_slope, upward_variance = _among(upward, mean.upward_slope, mean.upward_steepness, slope, slopes)
    upward_alpha2 = (mean.upward_alpha2 / upward).clamp(_MIN_ALPHA2, 1)
    metallic_variance = (mean.metallic2 - metallic * metallic).clamp(0, 1)
    # `to_widened` narrows what is as rough as can be.
    differing = (to_lean.clamp(min=0) + to_widened - to_geometric.clamp(max=0)).clamp(min=0)
    return Statistics(
        base=base,
        metallic=metallic,
        roughness=roughness,
        log_roughness=log_roughness,
        normal=normal,
        to_lean=to_lean,
        to_widened=to_widened,
        to_geometric=to_geometric,
        to_quartic=quartic.log() / 4 - log_roughness,
        lean_normal=lean_normal,
        spread=spread,
        metallic_variance=metallic_variance,
        metallic_colour=mean.metallic_base - metallic * base,
        slopes=slopes,
        axes=_at_most_one(torch.cat([xx - yy, 2 * xy_], -1) / (slopes + 1e-5)),
        to_tall=(1 / tall + tall_variance).clamp(_MIN_ALPHA2, 1).log() / 4 - log_roughness,
        to_upward=(upward_alpha2 + upward_variance).clamp(_MIN_ALPHA2, 1).log() / 4 - log_roughness,
        to_narrowest=(-tall.log() / 4 - log_roughness).clamp(max=0),
        tall_normal=_leaning(tall_slope) - normal,
        upward_normal=_leaning(upward_slope) - normal,
        freedom=differing / (differing + _SOFT),
        tall_freedom=_widening(tall_variance, 1 / tall),
        upward_freedom=_widening(upward_variance, upward_alpha2),
        colour_freedom=_share(spread) + _share(metallic_variance),
    )


def _at_most_one(vector: Tensor) -> Tensor:
    """Shortened to length 1 where it is longer, as no covariance is, but sums with negative weights are."""
    return vector * vector.square().sum(-1, keepdim=True).clamp(min=1).rsqrt()


def _leaning(slope: Tensor) -> Tensor:
    """x and y of the unit normals of slopes."""
    return slope * (1 + slope.square().sum(-1, keepdim=True)).rsqrt()


def _among(weight: Tensor, first: Tensor, second: Tensor, slope: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance of slopes among weighted texels, from averages of the products with their weight.

    Few texels with nearly all of the weight cannot lie far outside of the variance of all, `slopes` around `slope`.
    """
    reach = _FARTHEST * slopes.sqrt()
    mean = slope + torch.minimum(torch.maximum(first / weight - slope, -reach), reach)
    variance = (second / weight - mean.square().sum(-1, keepdim=True)).clamp(min=0)
    return mean, torch.minimum(variance, _FARTHEST * slopes)


def _widening(variance: Tensor, alpha2: Tensor) -> Tensor:
    """How much a variance of slopes widens a lobe, from 0 to 1, as `freedom` measures it."""
    logarithm = (variance / alpha2).log1p() / 4
    return logarithm / (logarithm + _SOFT)


def _share(variance: Tensor) -> Tensor:
    return (variance - _ROUNDING).clamp(min=0) / (variance + _SOFT_VARIANCE)


FEATURES = statistics(torch.zeros(1, COUNT)).features().shape[-1]
"""Numbers that describe a texel to a decoder."""
