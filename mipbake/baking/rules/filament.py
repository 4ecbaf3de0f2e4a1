"""`filament`: the rule of Filament's roughness-prefilter tool (after Karis 2018, "Normal map filtering using vMF").

With r = |mean unit normal| and kappa = (3 r - r^3) / (1 - r^2):
rough' = sqrt(rough^2 + min(1 / (2 kappa), 0.2^2)).

rough is perceptual roughness, as the tool stores it, and the level's is the mean of the stored values. (For anisotropic
materials that is the tensor S^(1/4), averaged.) At level 0 the tool leaves roughness alone, and so does the box.
"""

from __future__ import annotations

import numpy as np

from mipbake.baking.rules.averages import RoughnessRule, inverse_kappa, perceptual

_SCALE, _LIMIT = 0.5, 0.2**2  # Filament's own numbers

FILAMENT = RoughnessRule(
    name="filament",
    summary="averages, roughness widened as by Filament's roughness-prefilter",
    averaged=perceptual,
    restored=lambda rough: rough**4,
    widened=lambda alpha2, variance: np.square(np.sqrt(alpha2) + np.minimum(_SCALE * inverse_kappa(variance), _LIMIT)),
)
