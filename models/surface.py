"""What the texels of any material model say of a surface, as tensors: normals, how rough lobes are, and how stretched.

A lobe is a round one, whose roughness r is the geometric mean over both axes (alpha = r^2), and a stretch. The stretch
is (d, c) of the log-roughness tensor [[m + d, c], [c, m - d]], where m = 4 ln r. Its length is the logarithm of the
ratio of both alphas.
"""

from __future__ import annotations

import torch
from torch import Tensor

from mipbake.material import Kind, MaterialModel


def unit_normals(stored: Tensor, model: MaterialModel) -> Tensor:
    """(..., C) stored channels to (..., 3) normals; x and y alone are lifted."""
    normal = stored[..., model.normal]
    if normal.shape[-1] == 3:
        return normal
    return torch.cat([normal, (1 - normal.square().sum(-1, keepdim=True)).clamp(min=0).sqrt()], -1)


def round_roughness(stored: Tensor, model: MaterialModel) -> Tensor:
    """(..., C) stored channels to (..., 1): perceptual roughness, as stored or the geometric mean of both axes."""
    for tensor in model.of(Kind.LOG_TENSOR):
        return (stored[..., tensor][..., :2].sum(-1, keepdim=True) / 8).exp()
    (roughness,) = model.of(Kind.ROUGHNESS)
    return stored[..., roughness]


def stretch(stored: Tensor, model: MaterialModel) -> Tensor:
    """(..., C) stored channels to (..., 2); to (..., 0) where a model has no log-roughness tensor."""
    for tensor in model.of(Kind.LOG_TENSOR):
        a, b, c = torch.split(stored[..., tensor], 1, -1)
        return torch.cat([(a - b) / 2, c], -1)
    return stored[..., :0]


def log_tensor(roughness: Tensor, stretch: Tensor) -> Tensor:
    """(..., 1) and (..., 2) to (..., 3) a, b, c; the inverse of `round_roughness` and `stretch`."""
    mean, (d, c) = 4 * roughness.log(), torch.split(stretch, 1, -1)
    return torch.cat([mean + d, mean - d, c], -1)


def maps(stored: Tensor, model: MaterialModel, kind: Kind) -> Tensor:
    """(..., C) stored channels to the channels of all maps of a kind, side by side; (..., 0) where there is none."""
    return torch.cat([stored[..., :0], *(stored[..., channels] for channels in model.of(kind))], -1)
