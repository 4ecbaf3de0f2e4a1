"""Random materials and light-view pairs for the tests of shading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.material import MAX_LOG_GAMMA

Array = NDArray[np.float64]

MODELS = dict(_native.models())
TENSOR_MODELS = ("ggx", "beckmann")
"""Models with albedo, F0, the normal's x and y and a log-roughness tensor, in this order."""
SMALLEST_ALPHA = 0.002


def directions(rng: np.random.Generator, *shape: int) -> Array:
    """Unit vectors over the whole sphere, three quarters of them above the horizon."""
    d = rng.standard_normal((*shape, 3))
    d[..., 2] = np.where(rng.random(shape) < 0.5, np.abs(d[..., 2]), d[..., 2])
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def pairs(rng: np.random.Generator, *shape: int) -> tuple[Array, Array]:
    """Lights and views (..., 3), a half of the lights near the mirror direction of their view."""
    view = directions(rng, *shape)
    mirror = view * [-1, -1, 1] + 0.05 * rng.standard_normal((*shape, 3))
    light = np.where(rng.random((*shape, 1)) < 0.5, mirror / np.linalg.norm(mirror, axis=-1, keepdims=True), 0)
    return np.where(light.any(-1, keepdims=True), light, directions(rng, *shape)), view


def material(rng: np.random.Generator, model: str, *shape: int) -> Array:
    """Stored channels (..., C) over the whole range that float32 is held to: alpha from 0.002 to 1, any tilt."""
    u = rng.random
    if model in TENSOR_MODELS:
        tilt = rng.uniform(-1.1, 1.1, (*shape, 2))  # some outside the unit disc
        low = 2 * np.log(SMALLEST_ALPHA)
        e1, e2, angle = rng.uniform(low, 0, shape), rng.uniform(low, 0, shape), rng.uniform(0, np.pi, shape)
        c, s = np.cos(angle), np.sin(angle)
        log_tensor = np.stack([e1 * c * c + e2 * s * s, e1 * s * s + e2 * c * c, (e1 - e2) * c * s], -1)
        log_tensor[..., ::7, 1] = log_tensor[..., ::7, 0]  # some isotropic
        log_tensor[..., ::7, 2] = 0
        ggx = np.concatenate([u((*shape, 6)), tilt, log_tensor], -1)
        if model == "ggx":
            return ggx
        return np.concatenate([ggx, rng.uniform(-MAX_LOG_GAMMA, MAX_LOG_GAMMA, (*shape, 1))], -1)
    stored = np.concatenate([u((*shape, 5)), directions(rng, *shape)], -1)
    stored[..., 5:8] *= rng.uniform(0.3, 1.2, (*shape, 1))  # normals come filtered, so shorter than 1
    if model == "gltf-anisotropic":
        stored = np.concatenate([stored, rng.uniform(-1, 1, (*shape, 2)), u((*shape, 1))], -1)
    return stored


def smooth_material(rng: np.random.Generator, model: str, *shape: int) -> Array:
    """Stored channels away from every kink and from the narrowest lobes, for finite differences."""
    stored = material(rng, model, *shape)
    if model in TENSOR_MODELS:
        stored[..., 6:8] *= 0.5
        stored[..., 8:11] *= 0.3
        stored[..., 11:] *= 0.5
    else:
        stored[..., 4] = 0.3 + 0.7 * stored[..., 4]
        stored[..., 5:8] = stored[..., 5:8] * 0.3 + [0, 0, 1]
    return stored
