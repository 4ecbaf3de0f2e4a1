"""Anisotropic lobes from averages: which way a level's texel is rougher, and by how much.

Slopes that vary more along one axis make a lobe that is wider along it. With the covariance tensor of slopes and the
mean of alpha^2, `lean` says by how much: its tensor has eigenvalues q + 2 s_1 and q + 2 s_2. Half of the logarithm of
the ratio of both alphas and twice their angle are a vector, which is zero where a lobe is round, and in which axes that
differ by 180 degrees are one. A network corrects it as it corrects everything else: in terms that vanish on a constant
material, where the lobe stays round.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mipbake.material import MIN_ROUGHNESS
from mipbake.models.moments import Statistics

OUTPUTS = 3
"""Numbers of a decoder that `stretched` takes."""

_MOST_SHARE = 1.5  # share of `lean`'s anisotropy; an untrained network has a third of it
_DECISION = 4.0
_MOST = 0.98  # share of the anisotropy that a tensor can have
_FREE = 0.5  # half of the logarithm of the ratio of alphas that is free where closed forms disagree
_LEAST = 1e-12  # squared length of a vector whose angle still means something


def stretched(found: Statistics, roughness: Tensor, out: Tensor) -> tuple[Tensor, Tensor]:
    """Roughness of the narrower axis (..., 1), and (..., 3) direction of the wider one and strength, of `gltf`.

    Args:
        found: averages. roughness: (..., 1) of the round lobe, the geometric mean of both. out: (..., OUTPUTS).

    Returns:
        What KHR_materials_anisotropy stores: alpha across, and along mix(alpha, 1, strength^2). Differentiable; the
        direction of a round lobe is +x and has no gradient.
    """
    quartic = (4 * (found.log_roughness + found.to_quartic)).exp()
    ratio = found.slopes * found.axes / (quartic + found.slopes)
    length = ratio.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
    lean = ratio / length * length.clamp(max=_MOST).atanh() / 2
    share = _MOST_SHARE * torch.sigmoid(_DECISION * out[..., :1] - math.log(2))
    vector = share * lean + _FREE * found.freedom * out[..., 1:3].tanh()
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
    return narrow, torch.cat([angle.cos(), angle.sin(), strength.clamp(max=1)], -1)
