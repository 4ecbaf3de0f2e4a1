"""Material models as channel layouts, and the conversions between them.

A texel of a model is a vector of *stored channels*: what an engine samples, bilinearly and trilinearly, before it
shades. Arrays are `(..., C)` of float32 or float64; every function is pure and keeps dtype and leading shape.

| model | channels |
|---|---|
| `gltf` | base colour r, g, b (linear Rec.709); metallic; perceptual roughness; normal x, y, z |
| `gltf-anisotropic` | the channels of `gltf`; anisotropy direction x, y; anisotropy strength |
| `ggx` | diffuse albedo r, g, b; specular F0 r, g, b; normal x, y; log-roughness tensor a, b, c |
| `beckmann` | the channels of `ggx`; g = ln(gamma) |

glTF 2.0, appendix B, with KHR_materials_anisotropy; the log-roughness tensor is equation 6 of Kemppinen et al. 2023:
S = exp([[a, c], [c, b]]) with eigenvalues alpha_x^2, alpha_y^2, in the tangent frame of the shading normal. gamma is
the exponent of the generalised Beckmann distribution of Aittala et al. 2015: 1 is Beckmann, less has a sharper peak and
longer tails. Its masking is Beckmann's own, of gamma = 1, whatever gamma is: an approximation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import UsageError

Array = NDArray[np.floating]

DIELECTRIC_F0 = 0.04
"""Reflectance at normal incidence of every non-metal in the metallic-roughness model."""

MIN_ROUGHNESS = 0.045
"""Floor of perceptual roughness when shading: engines clamp there too, and narrower lobes strain 32-bit arithmetic."""

MIN_NORMAL_Z = 0.02
"""Least height of a unit normal that is believed, where slopes reach 50, 89 degrees from flat: the range of slopes.

Beyond it lie normals that point along the surface or into it, which no surface has. Of the 130 scanned sets that the
limits of mipbake.io.normal were set on, 122 stay above it everywhere; the others have 1 to 87 texels below, of 2^18 or
2^20, nearly all where rock overhangs."""

MAX_LOG_GAMMA = 1.5
"""Limit of |g| = |ln(gamma)| of `beckmann`: gamma from 0.22, more peaked than materials are, to 4.5, nearly a disc."""


@dataclass(frozen=True)
class MaterialModel:
    """A channel layout: the maps a model is stored in, in order, with the channels of each.

    Args:
        name: what users call it.
        maps: map name to its slice of the stored channels.
        limits: (C, 2) lowest and highest value of each stored channel.
    """

    name: str
    maps: Mapping[str, slice]
    limits: tuple[tuple[float, float], ...]

    @property
    def channels(self) -> int:
        """Number of stored channels C."""
        return len(self.limits)

    @property
    def unit_vectors(self) -> tuple[slice, ...]:
        """Channel groups that are unit vectors and are renormalised after filtering."""
        return tuple(s for m, s in self.maps.items() if m in _UNIT_VECTORS and s.stop - s.start == _UNIT_VECTORS[m])


_UNIT_VECTORS = {"normal": 3, "anisotropy_direction": 2}
_UNIT, _SIGNED, _LOG = (0.0, 1.0), (-1.0, 1.0), (-30.0, 10.0)

_GLTF_MAPS = {"base_color": slice(0, 3), "metallic": slice(3, 4), "roughness": slice(4, 5), "normal": slice(5, 8)}
_GLTF_LIMITS = (_UNIT,) * 5 + (_SIGNED,) * 3
_GGX_MAPS = {"diffuse": slice(0, 3), "specular": slice(3, 6), "normal": slice(6, 8), "log_roughness": slice(8, 11)}
_GGX_LIMITS = (_UNIT,) * 6 + (_SIGNED,) * 2 + (_LOG,) * 3

MODELS: Mapping[str, MaterialModel] = {
    m.name: m
    for m in (
        MaterialModel("gltf", _GLTF_MAPS, _GLTF_LIMITS),
        MaterialModel(
            "gltf-anisotropic",
            _GLTF_MAPS | {"anisotropy_direction": slice(8, 10), "anisotropy_strength": slice(10, 11)},
            (*_GLTF_LIMITS, _SIGNED, _SIGNED, _UNIT),
        ),
        MaterialModel("ggx", _GGX_MAPS, _GGX_LIMITS),
        MaterialModel(
            "beckmann",
            _GGX_MAPS | {"log_gamma": slice(11, 12)},
            (*_GGX_LIMITS, (-MAX_LOG_GAMMA, MAX_LOG_GAMMA)),
        ),
    )
}


def model_named(name: str) -> MaterialModel:
    """The model of that name; UsageError with the list of names when there is none."""
    if name not in MODELS:
        raise UsageError(f"unknown material model {name!r}: expected one of {', '.join(MODELS)}")
    return MODELS[name]


def regularise(stored: Array, model: str) -> Array:
    """Clips stored channels to their limits and renormalises unit vectors, as a shader does after filtering.

    Vectors shorter than 1e-6 become +Z (normals) or +X (directions). Shape and dtype are kept.
    """
    layout = model_named(model)
    low, high = np.array(layout.limits, stored.dtype).T
    out = np.clip(stored, low, high)
    for group in layout.unit_vectors:
        v = stored[..., group]
        length = np.linalg.norm(v, axis=-1, keepdims=True)
        axis = np.zeros(group.stop - group.start, stored.dtype)
        axis[-1 if len(axis) == 3 else 0] = 1
        out[..., group] = np.where(length > 1e-6, v / np.maximum(length, 1e-6), axis)
    return out


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


def gltf_to_ggx(stored: Array) -> Array:
    """`gltf` or `gltf-anisotropic` channels to `ggx`: albedo = (1 - metallic) base, F0 = mix(0.04, base, metallic).

    Roughness is raised to MIN_ROUGHNESS. What remains of the difference between the models is the factor (1 - F) that
    glTF puts on the diffuse term and `ggx` does not.
    """
    base, metallic = stored[..., 0:3], stored[..., 3:4]
    alpha = np.square(np.maximum(stored[..., 4], MIN_ROUGHNESS))
    if stored.shape[-1] > 8:
        abc = tensor_log(axes_to_tensor(alpha, stored[..., 10], stored[..., 8:10]))
    else:
        log_alpha2 = 2 * np.log(alpha)
        abc = np.stack([log_alpha2, log_alpha2, np.zeros_like(log_alpha2)], -1)
    specular = DIELECTRIC_F0 + (base - DIELECTRIC_F0) * metallic
    return np.concatenate([base * (1 - metallic), specular, stored[..., 5:7], abc], -1)


def base_and_metallic(albedo: Array, specular: Array) -> tuple[Array, Array]:
    """Base colour (..., 3) and metallic (..., 1) from diffuse albedo and F0 (..., 3), exact on what glTF can represent.

    Dark metals (F0 below 0.04) have two representations: base colour and metallic may differ where albedo and F0 agree.
    base = albedo + F0 - 0.04 (1 - m) in every channel; with channel means, m solves
    0.04 m^2 + (albedo + F0 - 0.08) m - (F0 - 0.04) = 0.
    """
    excess = specular.mean(-1, keepdims=True) - DIELECTRIC_F0
    b = albedo.mean(-1, keepdims=True) + specular.mean(-1, keepdims=True) - 2 * DIELECTRIC_F0
    root = np.sqrt(np.maximum(b * b + 4 * DIELECTRIC_F0 * excess, 0))
    # Without cancellation on either side of b = 0. Below F0 = 0.04 there are two solutions; the less metallic is taken.
    shiny = np.where(b >= 0, 2 * excess / np.maximum(b + root, 1e-12), (root - b) / (2 * DIELECTRIC_F0))
    dark = np.where(b < 0, -2 * excess / np.maximum(root - b, 1e-12), 0)
    metallic = np.clip(np.where(excess > 0, shiny, dark), 0, 1)
    return np.clip(albedo + specular - DIELECTRIC_F0 * (1 - metallic), 0, 1), metallic


def ggx_to_gltf(stored: Array) -> Array:
    """`ggx` channels to `gltf`. Anisotropy is lost: alpha^2 becomes the geometric mean of the tensor's eigenvalues."""
    base, metallic = base_and_metallic(stored[..., 0:3], stored[..., 3:6])
    roughness = np.exp((stored[..., 8:9] + stored[..., 9:10]) / 8)
    return np.concatenate([base, metallic, np.clip(roughness, 0, 1), lift_normal(stored[..., 6:8])], -1)


def ggx_to_gltf_anisotropic(stored: Array) -> Array:
    """`ggx` channels to `gltf-anisotropic`, exact where both axes are at most 1."""
    base, metallic = base_and_metallic(stored[..., 0:3], stored[..., 3:6])
    alpha, strength, direction = tensor_to_axes(tensor_exp(stored[..., 8:11]))
    return np.concatenate(
        [base, metallic, np.sqrt(alpha)[..., None], lift_normal(stored[..., 6:8]), direction, strength[..., None]], -1
    )


def _ggx_twin(log_alpha: Array) -> tuple[Array, Array, Array, Array]:
    """What stands for a GGX lobe in `beckmann`: ln(alpha_b / alpha), g, and their derivatives by ln alpha.

    docs/fit_beckmann.py fitted it to mirrors that shade as mirrors of GGX do, in equal shares over the pair sets
    near-mirror and hemisphere. For narrow lobes the fit does not depend on alpha: both distributions are a function of
    tan(theta) / alpha over cos^4 theta. For rough lobes it has a longer way to go.
    """
    alpha = np.exp(np.minimum(log_alpha, 5))
    wide, sharp = (np.asarray(alpha**n / (alpha**n + h**n)) for n, h in ((2.5, 0.35), (3, 0.5)))
    return (
        -0.391 + 0.55 * wide,
        -0.612 + 0.5 * sharp,
        0.55 * 2.5 * wide * (1 - wide),
        0.5 * 3 * sharp * (1 - sharp),
    )


_NARROWING = np.polynomial.Polynomial([0.0767, 0.4051, -0.4103, 0.2319, -0.0982, 0.0237])
"""As a function of g, ln(alpha_b / alpha) of the GGX lobe that is nearest to a narrow `beckmann` one in the mean square
of the reflected radiance. docs/fit_beckmann.py fitted it, within 0.003."""


def least_alpha2(model: str) -> float:
    """The least eigenvalue of S that stacks hold: narrower lobes are not shaded, or in `beckmann` their twins."""
    alpha = MIN_ROUGHNESS**2
    return float(np.square(alpha * np.exp(_ggx_twin(np.log(alpha))[0] if model == "beckmann" else 0.0)))


def ggx_to_beckmann(stored: Array) -> Array:
    """`ggx` channels to `beckmann`: the roughness tensor scaled, and g, as functions of alpha = det(S)^(1/4).

    The tails of GGX are longer than any exponential's, so the models never agree. `beckmann_to_ggx` is its inverse.

    What is kept of an isotropic mirror's reflection, in dB of signal to error near the mirror direction and over the
    hemisphere, over views from everywhere: for alpha 22 and 22 at 0.01, 20 and 22 at 0.03, 16 and 19 at 0.1, 15 and 15
    at 0.2, 15 and 9 at 0.5, 16 and 5 at 1. Views that graze decide that: over those that the fit saw, whose cosines are
    0.2 and more, it is 21 and 20 at 0.1.
    """
    log_alpha = (stored[..., 8:9] + stored[..., 9:10]) / 4
    shift, g, *_ = _ggx_twin(log_alpha)
    scaled = [stored[..., 8:10] + 2 * shift, stored[..., 10:11], g]
    return np.concatenate([stored[..., :8], *scaled], -1, dtype=stored.dtype)


def beckmann_to_ggx(stored: Array) -> Array:
    """`beckmann` channels to `ggx`: the roughness tensor of the nearest GGX lobe; g is lost.

    The inverse of `ggx_to_beckmann` on what that gives, to rounding. For any other g the scale of the tensor is further
    multiplied by the ratio between the nearest narrow GGX lobes of both: in dB of signal to error of a narrow lobe, 8
    at g = -1.5, 15 at -1, 21 at -0.5, 14 at 0 (Beckmann), 8 at 1 and 7 at 1.5.
    """
    log_alpha_b, g = (
        (stored[..., 8:9] + stored[..., 9:10]) / 4,
        np.clip(stored[..., 11:12], -MAX_LOG_GAMMA, MAX_LOG_GAMMA),
    )
    given, slope = _NARROWING(g), _NARROWING.deriv()
    log_alpha = log_alpha_b - given
    for _ in range(5):  # Newton: ln alpha + shift(alpha) + given - narrowing(g of alpha) = ln alpha_b, slope 0.9 to 1.3
        shift, twin, shift_slope, twin_slope = _ggx_twin(log_alpha)
        excess = log_alpha + shift + given - _NARROWING(twin) - log_alpha_b
        log_alpha = log_alpha - excess / (1 + shift_slope - slope(twin) * twin_slope)
    scaled = [stored[..., 8:10] + 2 * (log_alpha - log_alpha_b), stored[..., 10:11]]
    return np.concatenate([stored[..., :8], *scaled], -1, dtype=stored.dtype)


def convert(stored: Array, source: str, target: str) -> Array:
    """Converts stored channels of one model to stored channels of another; `ggx` is the common ground of any two
    models."""
    source, target = model_named(source).name, model_named(target).name
    if source == target:
        return stored
    if source == "gltf" and target == "gltf-anisotropic":
        direction = np.broadcast_to(np.array([1, 0, 0], stored.dtype), (*stored.shape[:-1], 3))
        return np.concatenate([stored, direction], -1)
    common = _TO_GGX[source](stored)
    return _FROM_GGX[target](common)


def _same(stored: Array) -> Array:
    return stored


_TO_GGX: Mapping[str, Callable[[Array], Array]] = {
    "gltf": gltf_to_ggx,
    "gltf-anisotropic": gltf_to_ggx,
    "ggx": _same,
    "beckmann": beckmann_to_ggx,
}
_FROM_GGX: Mapping[str, Callable[[Array], Array]] = {
    "gltf": ggx_to_gltf,
    "gltf-anisotropic": ggx_to_gltf_anisotropic,
    "ggx": _same,
    "beckmann": ggx_to_beckmann,
}
