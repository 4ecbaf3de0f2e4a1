"""`godot`: the roughness limiter of the Godot engine's texture importer (Image::generate_mipmap_roughness, Godot 4).

With r = |mean unit normal| and kappa = (3 r - r^3) / (1 - r^2):
rough' = sqrt(rough^2 + min(0.75 / kappa, 0.4^2)).

rough is perceptual roughness, as the importer stores it, and the level's is the mean of the stored values. (For
anisotropic materials that is the tensor S^(1/4), averaged.) At level 0 the importer leaves roughness alone, and so does
the box.
"""

from __future__ import annotations

import numpy as np

from mipbake.baking.rules.averages import RoughnessRule, inverse_kappa, perceptual

_SCALE, _LIMIT = 0.75, 0.4**2  # Godot's own numbers

GODOT = RoughnessRule(
    name="godot",
    summary="averages, roughness widened as by Godot's importer",
    averaged=perceptual,
    restored=lambda rough: rough**4,
    widened=lambda alpha2, variance: np.square(np.sqrt(alpha2) + np.minimum(_SCALE * inverse_kappa(variance), _LIMIT)),
)
