"""Anisotropic lobes from averages: which way a level's texel is rougher, and by how much.

Round lobes become stretched ones where a model that is made stores directions; lobes that are read stretched are
stretched otherwise.

Slopes that vary more along one axis make a lobe that is wider along it. With the covariance tensor of slopes and the
mean of alpha^2, `lean` says by how much: its tensor has eigenvalues q + 2 s_1 and q + 2 s_2. Half of the logarithm of
the ratio of both alphas and twice their angle are a vector, which is zero where a lobe is round, and in which axes that
differ by 180 degrees are one. A network corrects it as it corrects everything else: in terms that vanish on a constant
material, where the lobe stays round.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from mipbake.material import MIN_ROUGHNESS, Kind, MaterialModel
from mipbake.models.moment_statistics import Statistics
from mipbake.models.moments import least_roughness
from mipbake.models.parameters import of_coordinates
from mipbake.models.surface import log_tensor

OUTPUTS = 3
"""Numbers of a decoder that `stretched` takes. Not tuned."""

_MOST_SHARE = 1.5  # share of `lean`'s anisotropy; an untrained network has a third of it
_DECISION = 4.0  # what an output of 1 counts in the logit of that share
_MOST = 0.98  # share of the anisotropy that a tensor can have
_FREE = 0.5  # half of the logarithm of the ratio of alphas that is free where closed forms disagree
_LEAST = 1e-12  # squared length of a vector whose angle still means something


def stretched(
    found: Statistics, roughness: Tensor, out: Tensor, added: Tensor, made: MaterialModel
) -> Mapping[Kind, Tensor]:
    """What a model stores of lobes whose geometric mean roughness is (..., 1).

    Args:
        found: averages. out: (..., OUTPUTS). added: what sharpening adds to the stretch, (..., 2) where a model that
            is read stores it.
        made: the model.

    Returns:
        Channels by their kinds. Differentiable; the direction of a round lobe is +x and has no gradient.
    """
    if made.lines is None:
        return {Kind.LOG_TENSOR: _tensors(found, roughness, out, added, made)}
    narrow, direction, strength = _lines(found, roughness, out)
    return {Kind.ROUGHNESS: narrow, Kind.DIRECTION: direction, Kind.STRENGTH: strength}


def _share(out: Tensor) -> Tensor:
    """(..., 1) of the anisotropy of `lean`."""
    return _MOST_SHARE * torch.sigmoid(_DECISION * out[..., :1] - math.log(2))


def _tensors(found: Statistics, roughness: Tensor, out: Tensor, added: Tensor, made: MaterialModel) -> Tensor:
    """(..., 3) log-roughness tensors: the mean stretch, a share of the change of `lean`, and a free one."""
    free = 2 * _FREE * found.freedom * out[..., 1:3].tanh()  # in logarithms of alpha^2
    stretch = found.stretch + _share(out) * found.lean_stretch + free + added
    tensor = log_tensor(roughness.clamp(min=least_roughness(made)), stretch)
    return of_coordinates(tensor, Kind.LOG_TENSOR, made.least_alpha2)


def _lines(found: Statistics, roughness: Tensor, out: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Roughness of the narrower axis (..., 1), direction of the wider one (..., 2) and strength (..., 1).

    They are what KHR_materials_anisotropy stores: alpha across, and along mix(alpha, 1, strength^2).
    """
    quartic = (4 * (found.log_roughness + found.to_quartic)).exp()
    ratio = found.slopes * found.axes / (quartic + found.slopes)
    length = ratio.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
    lean = ratio / length * length.clamp(max=_MOST).atanh() / 2
    vector = _share(out) * lean + _FREE * found.freedom * out[..., 1:3].tanh()
    squared = vector.square().sum(-1, keepdim=True)
    round_ = squared <= _LEAST
    # Neither a root nor an angle has a derivative at zero.
    half = torch.where(round_, torch.zeros_like(squared), torch.where(round_, torch.ones_like(squared), squared).sqrt())
    x = torch.where(round_, torch.ones_like(squared), vector[..., :1])
    angle = torch.atan2(torch.where(round_, torch.zeros_like(squared), vector[..., 1:]), x) / 2
    narrow = torch.maximum(roughness * (-half / 2).exp(), roughness.clamp(max=MIN_ROUGHNESS))
    across, along = narrow.square(), (roughness.square() * half.exp()).clamp(max=1)
    wider = (along - across) / (1 - across).clamp(min=1e-4)
    flat = wider <= _LEAST
    strength = torch.where(flat, torch.zeros_like(wider), torch.where(flat, torch.ones_like(wider), wider).sqrt())
    return narrow, torch.cat([angle.cos(), angle.sin()], -1), strength.clamp(max=1)
