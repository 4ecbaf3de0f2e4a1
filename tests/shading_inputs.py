"""Random materials and light-view pairs for the tests of shading."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.material import FACTS, Kind
from mipbake.material import MODELS as RECORDS

Array = NDArray[np.float64]

MODELS = dict(_native.models())
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


def frames(rng: np.random.Generator, N: int) -> Array:
    """(N, 3, 3): random rotations, a half of them with one axis mirrored."""
    q = np.linalg.qr(rng.standard_normal((N, 3, 3)))[0]
    q[::2, 1] *= -1
    return q


def relative_error(got: Any, expected: Any) -> float:
    zero = expected == 0
    assert np.array_equal(got[zero], expected[zero])
    return float(np.max(np.abs(got[~zero] - expected[~zero]) / np.abs(expected[~zero])))


_UNIT = (Kind.REFLECTANCE, Kind.SHARE, Kind.ROUGHNESS)
"""Kinds that are drawn together."""

_OTHERS = (Kind.NORMAL_XY, Kind.LOG_TENSOR), (Kind.NORMAL, Kind.DIRECTION, Kind.STRENGTH, Kind.LOG_GAMMA)
"""Kinds that are drawn before those, and kinds that are drawn after them: tolerances were measured with this order."""


def material(rng: np.random.Generator, model: str, *shape: int) -> Array:
    """Stored channels (..., C) over the whole range that float32 is held to: alpha from 0.002 to 1, any tilt."""
    layout = RECORDS[model]
    out = np.full((*shape, layout.channels), np.nan)
    plain = [channel for group in layout.of(*_UNIT) for channel in range(group.start, group.stop)]
    for kinds in _OTHERS:
        for kind in kinds:
            for group in layout.of(kind):
                out[..., group] = _channels(rng, kind, *shape)
        if kinds is _OTHERS[0]:
            out[..., plain] = rng.random((*shape, len(plain)))
    assert not np.isnan(out).any(), f"a kind of {model} is not drawn here"
    return out


def _channels(rng: np.random.Generator, kind: Kind, *shape: int) -> Array:
    if kind is Kind.LOG_TENSOR:
        low = 2 * np.log(SMALLEST_ALPHA)
        e1, e2, angle = rng.uniform(low, 0, shape), rng.uniform(low, 0, shape), rng.uniform(0, np.pi, shape)
        c, s = np.cos(angle), np.sin(angle)
        tensor = np.stack([e1 * c * c + e2 * s * s, e1 * s * s + e2 * c * c, (e1 - e2) * c * s], -1)
        tensor[..., ::7, 1] = tensor[..., ::7, 0]  # some isotropic
        tensor[..., ::7, 2] = 0
        return tensor
    if kind is Kind.NORMAL:
        normal = directions(rng, *shape)
        return normal * rng.uniform(0.3, 1.2, (*shape, 1))  # they come filtered, so shorter than 1
    low, high = (-1.1, 1.1) if kind is Kind.NORMAL_XY else FACTS[kind].limits  # some outside the unit disc
    return rng.uniform(low, high, (*shape, FACTS[kind].channels))


def smooth_material(rng: np.random.Generator, model: str, *shape: int) -> Array:
    """Stored channels away from every kink and from the narrowest lobes, for finite differences."""
    stored = material(rng, model, *shape)
    for each in RECORDS[model].stored:
        group = RECORDS[model].maps[each.name]
        if each.kind in (Kind.NORMAL_XY, Kind.LOG_GAMMA):
            stored[..., group] *= 0.5
        elif each.kind is Kind.LOG_TENSOR:
            stored[..., group] *= 0.3
        elif each.kind is Kind.ROUGHNESS:
            stored[..., group] = 0.3 + 0.7 * stored[..., group]
        elif each.kind is Kind.NORMAL:
            stored[..., group] = stored[..., group] * 0.3 + [0, 0, 1]
    return stored
