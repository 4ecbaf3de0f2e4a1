"""`vmf`: a von Mises-Fisher lobe around every normal, and one lobe of the same mean around them all.

After Han, Sun, Ramamoorthi and Grinspun 2007, "Frequency domain normal map filtering", and Neubelt and Pettineo 2013,
"Crafting a next-gen material pipeline for The Order: 1886", with one lobe. A lobe of concentration kappa = 2 / alpha^2
about n has the mean A n with A = coth(2 / alpha^2) - alpha^2 / 2. The lobe of a footprint has the mean of A n over the
footprint, of length R: alpha'^2 = 2 (1 - R^2) / (R (3 - R^2)), after Banerjee et al. 2005.

That last step is an approximate inverse: without any spread it returns an alpha^2 too small by up to 0.026. What it
gets wrong on the level's mean lobe alone is added back, so that what does not spread does not change.

Where S is anisotropic, A is a tensor with the axes of S; the mean tensor's eigenvalues, times the length of the mean
normal weighted by A's mean eigenvalue, are R along the two axes.
"""

from __future__ import annotations

import numpy as np

from mipbake.baking.rules.averages import RoughnessRule, inverse_kappa
from mipbake.baking.rules.bands import Array

_NEWTON_STEPS = 4


def shortening(alpha2: Array) -> Array:
    """1 - A: how far the mean of a lobe falls short of a unit vector, from 0 at alpha = 0; any shape."""
    # coth x - 1 = 2 / (exp(2 x) - 1); where the exponent is cut, that is far below rounding.
    return alpha2 / 2 - 2 / np.expm1(_exponent(alpha2))


def alpha2_of(shortened: Array) -> Array:
    """Inverse of shortening, by Newton's method from Banerjee's approximation; any shape, from 0 to below 1."""
    shortened = np.clip(shortened, 0, 0.99)
    alpha2 = _approximate(shortened, np.zeros_like(shortened))
    for _ in range(_NEWTON_STEPS):
        exponent = _exponent(alpha2)
        slope = 0.5 - np.square(exponent) / 2 / (np.expm1(exponent) * -np.expm1(-exponent))
        alpha2 = np.maximum(alpha2 - (shortening(alpha2) - shortened) / slope, 0)
    return alpha2


def _exponent(alpha2: Array) -> Array:
    return np.minimum(4 / np.maximum(alpha2, 0.01), 80)


def _approximate(shortened: Array, variance: Array) -> Array:
    """2 / kappa of R = (1 - shortened) r, with 1 - r^2 given."""
    return 2 * inverse_kappa(shortened * (2 - shortened) + np.square(1 - shortened) * variance)


def _widened(alpha2: Array, variance: Array) -> Array:
    lobe = shortening(alpha2)
    return _approximate(lobe, variance) + (alpha2 - _approximate(lobe, np.zeros_like(lobe)))


VMF = RoughnessRule(
    name="vmf",
    summary="von Mises-Fisher lobes, averaged",
    averaged=shortening,
    restored=alpha2_of,
    widened=_widened,
    weight=lambda alpha2: 1 - shortening(alpha2),
)
