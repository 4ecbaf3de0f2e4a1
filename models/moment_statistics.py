"""What averages of moments tell about a level's texel: statistics, and the changes of the averages that they suggest.

Every change that is offered here vanishes where a material is constant, so that there the averages stay as they are, 0
and 1 included.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mipbake.material import MaterialModel, most_roughness
from mipbake.models.channels import parts
from mipbake.models.moments import Moments, least_roughness, moment_count, moment_places

_FARTHEST = 3.0  # standard deviations from the mean slope to the mean slope of bright texels
_SOFT = 0.05  # logarithm of roughness by which closed forms differ where half of a free change is allowed
# Share of a square that float32 leaves where an equal square is taken from it; a guess above its rounding.
_CANCELLED = 4e-7
_ROUNDING = 2e-6  # what is left of the variance of a constant in float32; a guess above its rounding
# Variance of normals, of metallic or of a reflectance, where half of a change of colour is.
_SOFT_VARIANCE = 0.02
_MOST_ECCENTRIC = 1 - 1e-5  # of a tensor: half of the difference of its eigenvalues over half of their sum


class Statistics:
    """Averages of a level's texels and what follows from them; (..., n) each.

    What a model does not have is (..., 0) (mipbake.models.channels). Kernels with negative lobes leave ranges; every
    value is cut to its range.

    Args:
        means: (..., moment_count) averages of `moments` of a model. model: that model.

    Attributes:
        base, metallic, diffuse, specular, roughness: averages, 3, 1, 3, 3 and 1, cut to their range.
        stretch, log_gamma: averages, 2 and 1.
        log_roughness: of the roughness that is shaded, 1.
        normal: x and y of the mean normal, normalised.
        to_lean, to_geometric, to_quartic: by how much the logarithm of roughness is greater in `lean`, for the mean of
            ln roughness, and for the mean of alpha^2; 1 each. 0 on a constant material.
        to_widened: the same for alpha'^2 = (alpha^2 + 2 v (1 - alpha^2)) / (1 + 2 v) with v = (1 - r) / r and r the
            length of the mean normal, 1. The released weights were trained with this form of `unreal`, which that rule
            had before it followed the engine: it is narrower where alpha is near 1.
        lean_normal: the normal of the mean slope minus `normal`, 2.
        spread: variance of the unit normals, 1 - |mean|^2, 1.
        lean_stretch: by how much the stretch is another in `lean`, 2.
        metallic_variance: 1. metallic_colour: covariance of metallic and base colour, 3.
        specular_variance: 3. tall_specular, upward_specular: mean reflectance among bright texels by either weight
            minus the mean among all, 3 each.
        slopes: variance of both slopes together, 1. axes: their covariance tensor's deviator over it, 2.
        to_tall, to_upward: what `to_lean` is, among bright texels by either weight, 1 each.
        to_narrowest: for the mean of 1 / alpha^2, or 0, whichever is less, 1. No lobe should be much narrower.
        tall_normal, upward_normal: the normal of the mean slope among them minus `normal`, 2 each.
        freedom: from 0 on a constant material to 1 where closed forms disagree, 1.
        tall_freedom, upward_freedom: the same among bright texels: from 0 where those are alike, 1 each.
        colour_freedom: the same for colours, from what varies beside them, 1.
    """

    def __init__(self, means: Tensor, model: MaterialModel) -> None:
        mean: Moments[Tensor] = parts(moment_places(model), means)
        base, metallic, diffuse, specular = (
            each.clamp(0, 1) for each in (mean.base, mean.metallic, mean.diffuse, mean.specular)
        )
        self.base, self.metallic, self.diffuse, self.specular = base, metallic, diffuse, specular
        least, most = least_roughness(model), most_roughness(model)
        ends = least**4, most**4  # of alpha^2
        self.roughness = mean.roughness.clamp(0, most)
        self.stretch, self.log_gamma = mean.stretch, mean.log_gamma
        xy, drop, slope = mean.normal, mean.drop, mean.slope
        quartic = mean.alpha2.clamp(*ends)
        length2 = xy.square().sum(-1, keepdim=True)
        self.spread = (2 * drop - drop * drop - length2 * (1 + _CANCELLED)).clamp(0, 1)
        height = 1 - drop
        self.normal = xy * (length2 + height * height).clamp(min=1e-8).rsqrt()
        x, y = slope[..., :1], slope[..., 1:]
        xx, yy, xy_ = mean.slope_xx - x * x, mean.slope_yy - y * y, mean.slope_xy - x * y
        self.slopes = (xx + yy - _CANCELLED * (x * x + y * y)).clamp(0, 50)
        shaded = self.roughness.clamp(min=least)
        self.log_roughness = log_roughness = shaded.log()
        length = (1 - self.spread).clamp(min=1e-6).sqrt()
        concentration = (1 - length) / length
        alpha2 = shaded**4
        widened = (alpha2 + 2 * concentration * (1 - alpha2).clamp(min=0)) / (1 + 2 * concentration)
        self.axes = _at_most_one(torch.cat([xx - yy, 2 * xy_], -1) / (self.slopes + 1e-5))
        lean_alpha2, lean_stretch = _lean(quartic, mean.tensor, self.slopes, self.axes)
        self.to_lean = lean_alpha2.clamp(*ends).log() / 4 - log_roughness
        self.to_widened = widened.log() / 4 - log_roughness
        self.to_geometric = (mean.log_roughness.clamp(math.log(least), math.log(most)) - log_roughness).clamp(-2, 0.5)
        self.lean_normal = _leaning(slope) - self.normal
        # By Jensen's inequality; kernels with negative lobes break it.
        tall = torch.maximum(mean.height, 1 / quartic)
        tall_slope, tall_variance = _among(tall, mean.height_slope, mean.height_steepness, slope, self.slopes)
        upward = mean.upward.clamp(min=1e-4)
        upward_slope, upward_variance = _among(upward, mean.upward_slope, mean.upward_steepness, slope, self.slopes)
        upward_alpha2 = (mean.upward_alpha2 / upward).clamp(*ends)
        self.metallic_variance = (mean.metallic2 - metallic * metallic).clamp(0, 1)
        self.specular_variance = (mean.specular2 - specular * specular).clamp(0, 1)
        varied = torch.cat([self.metallic_variance, self.specular_variance], -1).sum(-1, keepdim=True)
        # `to_widened` narrows what is as rough as can be.
        differing = (self.to_lean.clamp(min=0) + self.to_widened - self.to_geometric.clamp(max=0)).clamp(min=0)
        self.to_quartic = quartic.log() / 4 - log_roughness
        self.lean_stretch = lean_stretch - mean.stretch
        self.metallic_colour = mean.metallic_base - metallic * base
        self.tall_specular = (mean.height_specular / tall).clamp(0, 1) - specular
        self.upward_specular = (mean.upward_specular / upward).clamp(0, 1) - specular
        self.to_tall = (1 / tall + tall_variance).clamp(*ends).log() / 4 - log_roughness
        self.to_upward = (upward_alpha2 + upward_variance).clamp(*ends).log() / 4 - log_roughness
        self.to_narrowest = (-tall.log() / 4 - log_roughness).clamp(max=0)
        self.tall_normal, self.upward_normal = _leaning(tall_slope) - self.normal, _leaning(upward_slope) - self.normal
        self.freedom = differing / (differing + _SOFT)
        self.tall_freedom = _widening(tall_variance, 1 / tall)
        self.upward_freedom = _widening(upward_variance, upward_alpha2)
        self.colour_freedom = _share(self.spread) + _share(varied)

    def features(self) -> Tensor:
        """(..., feature_count): the statistics scaled to about 1, for a decoder."""
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
            2 * self.diffuse - 0.8,
            2 * self.specular - 0.8,
            4 * self.specular_variance,
            4 * self.tall_specular,
            4 * self.upward_specular,
            self.stretch,
            2 * self.lean_stretch,
            self.log_gamma,
        ]
        return torch.cat(parts, -1)


def feature_count(model: MaterialModel) -> int:
    """Numbers that describe a texel to a decoder."""
    return Statistics(torch.zeros(1, moment_count(model)), model).features().shape[-1]


def _lean(quartic: Tensor, tensor: Tensor, slopes: Tensor, axes: Tensor) -> tuple[Tensor, Tensor]:
    """alpha^2 (..., 1) of the mean tensor plus the covariance of slopes twice, and its stretch (..., 2).

    Where no tensor is stored, (..., 0), the mean eigenvalue, and (..., 0).
    """
    if not tensor.shape[-1]:
        return quartic + slopes, tensor
    middle = torch.maximum(tensor[..., :1], quartic) + slopes
    difference = tensor[..., 1:] + slopes * axes
    length = difference.square().sum(-1, keepdim=True).sqrt()
    eccentric = (length / middle).clamp(max=_MOST_ECCENTRIC)
    alpha2 = middle * (1 - eccentric.square()).sqrt()
    return alpha2, torch.where(eccentric > 1e-6, difference / length.clamp(min=1e-30) * eccentric.atanh(), 0)


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
