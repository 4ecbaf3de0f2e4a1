"""`beckmann`: `ggx` with the generalised Beckmann distribution of Aittala et al. 2015.

gamma is its exponent: 1 is Beckmann, less has a sharper peak and longer tails. Its masking is Beckmann's own, of
gamma = 1, whatever gamma is: an approximation.
"""

from __future__ import annotations

import numpy as np

from mipbake.material.ggx import GGX_MAPS
from mipbake.material.kinds import MAX_LOG_GAMMA, MIN_ROUGHNESS, Kind
from mipbake.material.model import Lobe, MaterialModel, ModelMap, View
from mipbake.material.tensors import Array


def _ggx_twin(log_alpha: Array) -> tuple[Array, Array, Array, Array]:
    """What stands for a GGX lobe in `beckmann`: ln(alpha_b / alpha), g, and their derivatives by ln alpha.

    docs/fit_beckmann.py fitted it to mirrors that shade as mirrors of GGX do, in equal shares over the pair sets
    near-mirror and hemisphere. For narrow lobes the fit does not depend on alpha: both distributions are a function of
    tan(theta) / alpha over cos^4 theta. For rough lobes it has a longer way to go.
    """
    alpha = np.exp(np.minimum(log_alpha, 5))
    wide, sharp = (np.asarray(alpha**n / (alpha**n + h**n)) for n, h in ((1.9, 0.285), (1.76, 0.479)))
    return (
        -0.394 + 0.558 * wide,
        -0.617 + 0.561 * sharp,
        0.558 * 1.9 * wide * (1 - wide),
        0.561 * 1.76 * sharp * (1 - sharp),
    )


_NARROWING = np.polynomial.Polynomial([0.0767, 0.4051, -0.4103, 0.2319, -0.0982, 0.0237])
"""As a function of g, ln(alpha_b / alpha) of the GGX lobe that is nearest to a narrow `beckmann` one in the mean square
of the reflected radiance. docs/fit_beckmann.py fitted it, within 0.003."""


def ggx_to_beckmann(stored: Array) -> Array:
    """`ggx` channels to `beckmann`: the roughness tensor scaled, and g, as functions of alpha = det(S)^(1/4).

    The tails of GGX are longer than any exponential's, so the models never agree. `beckmann_to_ggx` is its inverse.

    What is kept of an isotropic mirror's reflection, in dB of signal to error near the mirror direction and over the
    hemisphere, over views from everywhere: for alpha 22 and 22 at 0.01, 20 and 22 at 0.03, 17 and 19 at 0.1, 15 and 15
    at 0.2, 15 and 9 at 0.5, 16 and 5 at 1.
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


def _least_alpha2() -> float:
    """alpha^2 of what stands for the narrowest GGX lobe that is shaded."""
    alpha = MIN_ROUGHNESS**2
    return float(np.square(alpha * np.exp(_ggx_twin(np.log(alpha))[0])))


BECKMANN = MaterialModel(
    name="beckmann",
    formula="anisotropic generalised Beckmann (Aittala et al. 2015): D(h) = exp(-q^gamma) / (pi Gamma(1 + 1/gamma) "
    "sqrt(det S) h_n^4), q = h_t^T S^-1 h_t / h_n^2, S = exp([[a, c], [c, b]]); height-correlated Smith masking of "
    "Beckmann (gamma = 1) on S; normal z = sqrt(1 - x^2 - y^2)",
    stored=(*GGX_MAPS, ModelMap("log_gamma", Kind.LOG_GAMMA, ("g = ln(gamma)",))),
    gltf=False,
    coated=False,
    lobe=Lobe("the short tails of an exponential"),
    least_alpha2=_least_alpha2(),
    to_ggx=beckmann_to_ggx,
    from_ggx=ggx_to_beckmann,
    view=View(
        ((0, 1, 2, 6), (3, 4, 5, 7), (8, 9, 10, 11)),
        """
    vec4 third = textureLod(uMap2, uv, lod);
    Surface s = tensorModel(textureLod(uMap0, uv, lod), textureLod(uMap1, uv, lod), third);
    float g = clamp(third.w, -1.5, 1.5);
    s.gamma = exp(g);
    s.norm = inverseGamma(1.0 + exp(-g));
    return s;""",
    ),
)
