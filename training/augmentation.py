"""Data augmentation (section 3.4 of Kemppinen et al. 2023), on batches of patches (B, S, S, C) of stored channels.

Valid materials stay valid: colours only trade places, normals stay unit and above the surface, roughness stays between
the floor that shading has and 1, exponents within their limits. Every kind of map is known here but directions of
anisotropy and their strengths.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mipbake.material import MAX_LOG_GAMMA, MIN_ROUGHNESS, Kind, lift_normal, model_named, unknown

Patches = NDArray[np.float32]
Values = NDArray[np.float32]  # (B, 1, 1): one number a patch

# Spreads of the random changes. The centres of roughness and slopes lean to gloss and steep normals, which are rare in
# real sets; a boost gives every patch as much.
_LOG_ALPHA2_MEAN, _LOG_ALPHA2_SPREAD = -0.5, 1.2
_LOG_ANISOTROPY_SPREAD = 0.8
_LOG_SLOPE_MEAN, _LOG_SLOPE_SPREAD = 0.1, 0.4
_LOG_ECCENTRICITY_SPREAD = 0.3
_LOG_GAMMA_MEAN, _LOG_GAMMA_SPREAD = 0.15, 0.4
_UNCHANGED = 0.25
"""Share of patches whose roughness, and of others whose normals, are left as they are."""

_DIRTY = 0.15
"""Share of patches that are made dark, and whose metals are made dirty."""

_MIN_HEIGHT = 0.05  # height of augmented normals, cos 87 degrees; slopes are limited accordingly


def augment(
    patches: Patches, model: str, rng: np.random.Generator, turned: bool = True, boosted: bool = False
) -> Patches:
    """Every augmentation of a single material, with random numbers of its own for each patch.

    Args:
        patches: of one material model.
        model: its name.
        rng: of the step.
        turned: they are also turned by multiples of 90 degrees and mirrored.
        boosted: every patch is made glossier and steeper by one factor each, and the random changes lean to neither.
            Otherwise they lean by as much, and a part of the patches stays as it is.
    """
    patches = permute_colours(patches, model, rng)
    if turned:
        patches = reorient(patches, model, rng)
    patches = change_roughness(patches, model, rng, boosted)
    patches = change_normals(patches, model, rng, boosted)
    patches = dirty_metals(patches, model, rng)
    return change_kurtosis(patches, model, rng)


def permute_colours(patches: Patches, model: str, rng: np.random.Generator) -> Patches:
    """Permutes red, green and blue; albedo and F0 alike, so that their correlation stays."""
    order = rng.permuted(np.tile(np.arange(3), (len(patches), 1)), axis=1)[:, None, None]
    out: Patches = patches.copy()
    for group in model_named(model).of(Kind.REFLECTANCE):
        out[..., group] = np.take_along_axis(patches[..., group], order, -1)
    return out


def reorient(patches: Patches, model: str, rng: np.random.Generator) -> Patches:
    """Rotates by a multiple of 90 degrees and mirrors, patch, normals and roughness tensor alike."""
    turns, mirrored = rng.integers(4, size=len(patches)), rng.integers(2, size=len(patches))
    return np.stack([turn(p, int(k), bool(m), model) for p, k, m in zip(patches, turns, mirrored, strict=True)])


def turn(patch: Patches, quarter_turns: int, mirror: bool, model: str) -> Patches:
    """(S, S, C) counterclockwise by quarter turns, seen with +Y up, then perhaps mirrored left to right."""
    out: Patches = np.rot90(patch, quarter_turns).copy()
    if mirror:
        out = out[:, ::-1].copy()
    for part in model_named(model).parts:
        own = out[..., part.channels]
        match part.kind:
            case Kind.NORMAL | Kind.NORMAL_XY:
                for _ in range(quarter_turns % 4):
                    own[..., 0], own[..., 1] = -own[..., 1], own[..., 0].copy()
                if mirror:
                    own[..., 0] *= -1
            case Kind.LOG_TENSOR:
                if quarter_turns % 2:
                    own[..., 0], own[..., 1], own[..., 2] = own[..., 1].copy(), own[..., 0].copy(), -own[..., 2]
                if mirror:
                    own[..., 2] *= -1
            case Kind.REFLECTANCE | Kind.SHARE | Kind.ROUGHNESS | Kind.LOG_GAMMA:
                pass
            case Kind.DIRECTION | Kind.STRENGTH:
                raise AssertionError(f"patches of {model} cannot be turned")
            case _:
                unknown(part.kind)
    return out


def boost(patches: Patches, model: str) -> Patches:
    """Makes patches a little glossier and steeper, all by the same factors (section 4 of Kemppinen et al. 2023).

    Alpha is multiplied by 0.78, and slopes by 1.1: what augmentations of boosted patches do in the mean.
    """
    still = np.zeros((len(patches), 1, 1), np.float32)
    patches = _with_lobes(patches, model, still + np.float32(_LOG_ALPHA2_MEAN))
    return _with_slopes(patches, model, still + np.float32(_LOG_SLOPE_MEAN), still, still)


def change_roughness(patches: Patches, model: str, rng: np.random.Generator, boosted: bool = False) -> Patches:
    """Scales the roughness tensor; where it is one, also turns it and stretches it along a random axis."""
    scale = _leaning(rng, len(patches), _LOG_ALPHA2_MEAN, _LOG_ALPHA2_SPREAD, boosted)
    if model_named(model).of(Kind.ROUGHNESS):
        return _with_lobes(patches, model, scale)
    stretch = _some(rng, len(patches), 0.0, _LOG_ANISOTROPY_SPREAD)
    twice, axis = (2 * np.pi * rng.random((2, len(patches), 1, 1))).astype(np.float32)
    return _with_lobes(patches, model, scale, stretch, twice, axis)


def _with_lobes(
    patches: Patches,
    model: str,
    scale: Values,
    stretch: Values | float = 0.0,
    twice: Values | float = 0.0,
    axis: Values | float = 0.0,
) -> Patches:
    """Patches with ln(alpha^2) moved by `scale`, and tensors turned by half of `twice` and stretched along an axis."""
    out: Patches = patches.copy()
    layout = model_named(model)
    for group in layout.of(Kind.ROUGHNESS):
        out[..., group.start] = np.clip(patches[..., group.start] * np.exp(scale / 4), MIN_ROUGHNESS, 1)
        return out
    (tensor,) = layout.of(Kind.LOG_TENSOR)
    a, b, c = np.moveaxis(patches[..., tensor], -1, 0)
    mean, d = (a + b) / 2, (a - b) / 2
    roughest = np.maximum(mean + np.hypot(d, c), 0)  # what other models convert to reaches a little beyond 0
    mean = mean + scale
    # (d, c) turns by twice the angle of the tensor.
    d, c = np.cos(twice) * d - np.sin(twice) * c, np.sin(twice) * d + np.cos(twice) * c
    d, c = d + stretch * np.cos(axis), c + stretch * np.sin(axis)
    radius = np.hypot(d, c)
    high, low = (np.clip(mean + s * radius, math.log(layout.least_alpha2), roughest) for s in (1, -1))
    shrink = (high - low) / np.maximum(2 * radius, 1e-6)
    mean = (high + low) / 2
    out[..., tensor] = np.stack([mean + shrink * d, mean - shrink * d, shrink * c], -1)
    return out


def change_normals(patches: Patches, model: str, rng: np.random.Generator, boosted: bool = False) -> Patches:
    """Scales slopes, by different factors along and across a random axis."""
    scale = _leaning(rng, len(patches), _LOG_SLOPE_MEAN, _LOG_SLOPE_SPREAD, boosted)
    stretch = _some(rng, len(patches), 0.0, _LOG_ECCENTRICITY_SPREAD)
    angle = (np.pi * rng.random((len(patches), 1, 1))).astype(np.float32)
    return _with_slopes(patches, model, scale, stretch, angle)


def _with_slopes(patches: Patches, model: str, scale: Values, stretch: Values, angle: Values) -> Patches:
    """Patches whose slopes are scaled by exp(scale + stretch) along an axis, and by exp(scale - stretch) across it."""
    group = model_named(model).normal
    stored = patches[..., group]
    normal = stored if stored.shape[-1] == 3 else lift_normal(stored)
    slope = normal[..., :2] / np.maximum(normal[..., 2:], _MIN_HEIGHT)
    cos, sin = np.cos(angle), np.sin(angle)
    along = (cos * slope[..., 0] + sin * slope[..., 1]) * np.exp(scale + stretch)
    across = (cos * slope[..., 1] - sin * slope[..., 0]) * np.exp(scale - stretch)
    steepness = np.hypot(along, across)
    limit = np.minimum(1, math.sqrt(1 / _MIN_HEIGHT**2 - 1) / np.maximum(steepness, 1e-6))
    along, across = along * limit, across * limit
    changed = np.stack([cos * along - sin * across, sin * along + cos * across, np.ones_like(along)], -1)
    changed /= np.linalg.norm(changed, axis=-1, keepdims=True)
    out: Patches = patches.copy()
    out[..., group] = changed[..., : stored.shape[-1]]
    return out


def dirty_metals(patches: Patches, model: str, rng: np.random.Generator) -> Patches:
    """Takes a little from the metallic of some patches, and darkens them.

    Where a mirror reflects nothing bright, its little diffuse light is all there is to see of it. Few sets teach that.
    """
    out: Patches = patches.copy()
    layout = model_named(model)
    for share in layout.of(Kind.SHARE):
        chosen = (rng.random((len(patches), 1, 1, 1)) < _DIRTY).astype(np.float32)
        dirt, darkness = rng.beta(1, 8, (2, len(patches), 1, 1, 1)).astype(np.float32)
        out[..., share] *= 1 - chosen * dirt
        for group in layout.of(Kind.REFLECTANCE):
            out[..., group] *= 1 - chosen * (1 - darkness)
    return out


def change_kurtosis(patches: Patches, model: str, rng: np.random.Generator) -> Patches:
    """Shifts g = ln(gamma), where a model has it: sets converted from other models all have much the same."""
    out: Patches = patches.copy()
    for group in model_named(model).of(Kind.LOG_GAMMA):
        shift = _some(rng, len(patches), _LOG_GAMMA_MEAN, _LOG_GAMMA_SPREAD)
        out[..., group.start] = np.clip(patches[..., group.start] + shift, -MAX_LOG_GAMMA, MAX_LOG_GAMMA)
    return out


def _some(rng: np.random.Generator, count: int, mean: float, spread: float) -> Values:
    """(count, 1, 1) normally distributed, but 0 for the patches that stay unchanged."""
    values = rng.normal(mean, spread, count) * (rng.random(count) >= _UNCHANGED)
    return values.astype(np.float32).reshape(count, 1, 1)


def _leaning(rng: np.random.Generator, count: int, mean: float, spread: float, boosted: bool) -> Values:
    """As `_some`. Boosted, the mean is added to every patch, those that stay unchanged included."""
    return np.float32(mean) + _some(rng, count, 0.0, spread) if boosted else _some(rng, count, mean, spread)


def mix(first: Patches, second: Patches, rng: np.random.Generator, always: bool = False) -> Patches:
    """Where a Perlin noise lies above a random iso-level, `first`, elsewhere `second`.

    Half of the time all is `first`, unless it is to be both `always`.
    """
    count, size = first.shape[:2]
    noise = perlin(count, size, rng)
    # The level is a quantile, so that every share of the area is as likely as any other.
    shares = np.maximum(rng.uniform(0 if always else -1, 1, count), 0)
    levels = np.array([np.quantile(noise[i], shares[i]) for i in range(count)])
    inside = (noise >= levels[:, None, None])[..., None]
    return np.where(inside, first, second)


def perlin(count: int, size: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(count, size, size) Perlin noise (Perlin 1985), periodic, 2 x 2 cells and its octaves with halved amplitudes."""
    total = np.zeros((count, size, size), np.float32)
    cells, amplitude = 2, 1.0
    while cells <= size // 2:
        position = (np.arange(size, dtype=np.float32) + 0.5) * cells / size
        cell = position.astype(np.int64)
        inside = position - cell
        angle = (2 * np.pi * rng.random((count, cells, cells))).astype(np.float32)
        gradient = np.cos(angle), np.sin(angle)
        fade = inside**3 * (inside * (inside * 6 - 15) + 10)
        for dy in (0, 1):
            for dx in (0, 1):
                corner = ((cell + dy) % cells)[:, None], ((cell + dx) % cells)[None]
                dot = gradient[0][:, corner[0], corner[1]] * (inside - dx)
                dot += gradient[1][:, corner[0], corner[1]] * (inside - dy)[:, None]
                weight = (fade if dy else 1 - fade)[:, None] * (fade if dx else 1 - fade)
                total += amplitude * weight * dot
        cells, amplitude = cells * 2, amplitude / 2
    return total
