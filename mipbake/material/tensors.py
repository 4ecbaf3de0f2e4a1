"""Normals and roughness tensors: what conversions and descriptions of material models are written with.

Functions are pure, take (..., C) arrays of float32 or float64, and keep dtype and leading shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

MIN_NORMAL_Z = 0.02
"""Least height of a unit normal that is believed, where slopes reach 50, 89 degrees from flat: the range of slopes.

Beyond it lie normals that point along the surface or into it, which no surface has. Of the 130 scanned sets that the
limits of mipbake.source.normal were set on, 122 stay above it everywhere; the others have 1 to 87 texels below, of 2^18
or 2^20, nearly all where rock overhangs."""


def lift_normal(xy: Array) -> Array:
    """(..., 2) to (..., 3): z = sqrt(1 - x^2 - y^2); outside the unit disc (x, y) is first scaled back onto it."""
    radius = np.linalg.norm(xy, axis=-1, keepdims=True)
    xy = xy / np.maximum(radius, 1)
    return np.concatenate([xy, np.sqrt(np.maximum(1 - np.square(xy).sum(-1, keepdims=True), 0))], -1)


def tensor_exp(abc: Array) -> Array:
    """Symmetric 2 x 2 matrix exponential in closed form: (..., 3) log tensor (a, b, c) to (..., 3) S11, S22, S12.

    With m = (a + b) / 2, d = (a - b) / 2 and q = sqrt(d^2 + c^2):
    exp(M) = e^m (cosh q I + sinh(q) / q [[d, c], [c, -d]]).
    """
    a, b, c = np.moveaxis(abc, -1, 0)
    m, d = (a + b) / 2, (a - b) / 2
    q = np.hypot(d, c)
    sinhc = np.where(q > 1e-4, np.sinh(q) / np.maximum(q, 1e-4), 1 + q * q / 6)
    scale = np.exp(m)
    return np.stack([scale * (np.cosh(q) + sinhc * d), scale * (np.cosh(q) - sinhc * d), scale * sinhc * c], -1)


def tensor_log(tensor: Array) -> Array:
    """Inverse of tensor_exp: (..., 3) S11, S22, S12 of a positive definite tensor to (..., 3) a, b, c."""
    s11, s22, s12 = np.moveaxis(tensor, -1, 0)
    mean, d = (s11 + s22) / 2, (s11 - s22) / 2
    radius = np.hypot(d, s12)
    high = mean + radius
    # det / high, not mean - radius: no cancellation where one axis is much narrower than the other.
    low = np.maximum(s11 * s22 - s12 * s12, np.finfo(tensor.dtype).tiny) / high
    half_ratio = (np.log(high) - np.log(low)) / 2
    slope = half_ratio / np.maximum(radius, np.finfo(tensor.dtype).tiny)
    slope = np.where(radius > 1e-6 * mean, slope, 1 / mean)
    m = (np.log(high) + np.log(low)) / 2
    return np.stack([m + slope * d, m - slope * d, slope * s12], -1)


def full_tensor(tensor: Array) -> Array:
    """(..., 3) S11, S22, S12 of a roughness tensor that may be (..., 1), the eigenvalue of a round lobe."""
    return tensor if tensor.shape[-1] == 3 else np.concatenate([tensor, tensor, np.zeros_like(tensor)], -1)


def axes_to_tensor(alpha: Array, strength: Array, direction: Array) -> Array:
    """KHR_materials_anisotropy to the roughness tensor (..., 3) S11, S22, S12.

    alpha_t = mix(alpha, 1, strength^2) along the direction, alpha_b = alpha across it. alpha and strength are (...),
    direction (..., 2) unit.
    """
    along = np.square(alpha + (1 - alpha) * np.square(strength))
    across = np.square(alpha)
    x, y = direction[..., 0], direction[..., 1]
    return np.stack([along * x * x + across * y * y, along * y * y + across * x * x, (along - across) * x * y], -1)


def tensor_to_axes(tensor: Array) -> tuple[Array, Array, Array]:
    """Inverse of axes_to_tensor: alpha (...), strength (...) and direction (..., 2), in the half plane x >= 0.

    alpha = alpha_min, strength = sqrt((alpha_max - alpha_min) / (1 - alpha_min)), direction along alpha_max.
    """
    s11, s22, s12 = np.moveaxis(tensor, -1, 0)
    mean, d = (s11 + s22) / 2, (s11 - s22) / 2
    radius = np.hypot(d, s12)
    high = mean + radius
    low = np.maximum(s11 * s22 - s12 * s12, 0) / np.maximum(high, np.finfo(tensor.dtype).tiny)
    alpha_max, alpha_min = np.sqrt(np.clip(high, 0, 1)), np.sqrt(np.clip(low, 0, 1))
    strength = np.sqrt(np.clip((alpha_max - alpha_min) / np.maximum(1 - alpha_min, 1e-6), 0, 1))
    angle = np.arctan2(s12, d) / 2
    return alpha_min, strength, np.stack([np.cos(angle), np.sin(angle)], -1)


def mean_eigenvalue(tensor: Array) -> Array:
    """(..., 1): half the trace of a (..., 3) tensor; a (..., 1) one as it is."""
    return tensor if tensor.shape[-1] == 1 else (tensor[..., 0:1] + tensor[..., 1:2]) / 2


def positive_definite(tensor: Array, least: float) -> Array:
    """(..., 3) with its axes raised to the least alpha^2 of a model: rounding may take one below zero."""
    smallest = tensor.dtype.type(least)
    out: Array = np.maximum(tensor, smallest)
    limit = np.sqrt(np.maximum((out[..., 0] - smallest / 2) * (out[..., 1] - smallest / 2), 0))
    out[..., 2] = np.clip(tensor[..., 2], -limit, limit)
    return out
