"""`toksvig`: the specular exponent that a shortened average normal implies (Toksvig 2005, "Mipmapping normal maps").

With r = |mean unit normal| and the exponent s = 2 / alpha^2 - 2:
f = r / (r + s (1 - r)), s' = f s, alpha'^2 = 2 / (s' + 2).

This is solved for alpha^2, which needs no infinite exponent at alpha = 0, with v = (1 - r) / r:
alpha'^2 = (alpha^2 + 2 v (1 - alpha^2)) / (1 + 2 v (1 - alpha^2)).

Toksvig has one exponent for a whole texture. Where roughness varies, the level's alpha^2 is the mean of alpha^2 (of S):
the rule adds the variance of the normals to the variance of the lobe, 1 / s, and variances can be averaged.
"""

from __future__ import annotations

import numpy as np

from mipbake.baking.rules.averages import RoughnessRule, length
from mipbake.baking.rules.bands import Array


def excess(variance: Array) -> Array:
    """v = (1 - r) / r from 1 - r^2, any shape."""
    r = length(variance)
    return variance / (r * (1 + r))


def widened(alpha2: Array, v: Array) -> Array:
    """alpha'^2 from alpha^2 (unchanged from 1 on, where s ends) and v = (1 - r) / r; any shape."""
    added = 2 * v * np.maximum(1 - alpha2, 0)
    return np.asarray((alpha2 + added) / np.where(alpha2 < 1, 1 + added, 1))


TOKSVIG = RoughnessRule(
    name="toksvig",
    summary="averages, roughness widened by the length of the average normal (Toksvig)",
    averaged=lambda alpha2: alpha2,
    restored=lambda alpha2: alpha2,
    widened=lambda alpha2, variance: widened(alpha2, excess(variance)),
)
