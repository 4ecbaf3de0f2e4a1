"""Directions around lobes, in torch: half vectors distributed like GGX, and the densities of light-view pairs.

A lobe is four numbers: a unit normal that looks up, and alpha.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from mipbake.metrics.pairs import NEAR_MIRROR_SPREAD


def unit(vectors: Tensor) -> Tensor:
    """(..., 3) divided by their lengths."""
    return vectors * vectors.square().sum(-1, keepdim=True).clamp(min=1e-20).rsqrt()


def half_vectors(lobe: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """(K, P, 3) half vectors distributed like the GGX lobes (P, 4), of uniform numbers (K, P)."""
    normal, alpha = lobe[:, :3], lobe[:, 3]
    slope = alpha * (u / (1 - u).clamp(min=1e-6)).sqrt()
    height = (1 + slope.square()).rsqrt()
    angle = v * (2 * math.pi)
    # Frame of Duff et al. 2017 around a normal that looks up.
    a = -1 / (1 + normal[:, 2].clamp(min=-0.99))
    b = normal[:, 0] * normal[:, 1] * a
    tangent = torch.stack([1 + normal[:, 0].square() * a, b, -normal[:, 0]], -1)
    bitangent = torch.stack([b, 1 + normal[:, 1].square() * a, -normal[:, 1]], -1)
    x, y = slope * angle.cos() * height, slope * angle.sin() * height
    return x[..., None] * tangent + y[..., None] * bitangent + height[..., None] * normal


def reflected(view: Tensor, half: Tensor) -> Tensor:
    """(..., 3) lights that half vectors reflect to views."""
    return unit(2 * (view * half).sum(-1, keepdim=True) * half - view)


def lobe_density(lobe: Tensor, light: Tensor, view: Tensor) -> Tensor:
    """(K, P) density of (K, P, 3) lights whose half vectors with the views are distributed like the lobes (P, 4)."""
    half = unit(light + view)
    alpha2 = lobe[:, 3].square()
    signed = (half * lobe[:, :3]).sum(-1)
    sine2 = (half - lobe[:, :3] * signed[..., None]).square().sum(-1)  # 1 - cosine^2 would cancel
    cosine = signed.abs()  # a half vector and its opposite reflect alike
    distribution = alpha2 * cosine / (math.pi * (alpha2 * cosine.square() + sine2).square())
    return distribution * 0.25 / (half * view).sum(-1).abs().clamp(min=1e-4)


def around_mirror_density(light: Tensor, view: Tensor) -> Tensor:
    """(...) density of (..., 3) unit vectors around the mirror direction of views, above the horizon or not.

    A Gaussian around a point of the unit sphere, projected onto it: its integral along the ray, to 1e-13 where it is
    not negligible.
    """
    mirror = view * torch.tensor([-1.0, -1.0, 1.0])
    s2 = NEAR_MIRROR_SPREAD**2
    square = (light * mirror).sum(-1).clamp(min=0).square()
    density: Tensor = ((square - 1) / (2 * s2)).exp() * (square + s2) / (2 * math.pi * s2)
    return density


def near_mirror_density(light: Tensor, view: Tensor) -> Tensor:
    """(...) density of (..., 3) lights of the pair set `near-mirror`, given the views: those below the horizon are
    drawn again."""
    kept: Tensor = torch.special.ndtr(view[..., 2] / NEAR_MIRROR_SPREAD)
    return around_mirror_density(light, view) / kept


def hemisphere_density(light: Tensor) -> Tensor:
    """(...) density of (..., 3) lights of the pair set `hemisphere`."""
    return light[..., 2].clamp(min=0) / math.pi
