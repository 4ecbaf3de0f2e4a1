"""`unreal`: after Unreal Engine's composite textures (normal map into roughness), with a dead zone.

With r = |mean unit normal| and v = max(0, (1 - r) / r - 4e-5): alpha'^2 = (alpha^2 + 2 v (1 - alpha^2)) / (1 + 2 v), as
docs/conventions.md has it. The engine itself divides by 1 + 2 v (1 - alpha^2), as Toksvig's rule does. For glossy
materials the two are the same; the rule here takes a little roughness from materials of alpha^2 above 1/2.

alpha comes from the mean of the stored perceptual roughness, as the engine's texture has it. (For anisotropic materials
that is the tensor S^(1/4), averaged.)

The engine measures level 0 on a blurred copy of the normals, so that it is wider there too. The blur here is the 2 x 2
box of level 1 centred on the texel, weights 1/4, 1/2, 1/4 along each axis; the engine's own changed with its versions
(two taps, later five). A pixel filter other than the box is such a blur itself, and then nothing is added to it. The
normals that are stored are not blurred.
"""

from __future__ import annotations

import numpy as np

from mipbake.prefilter.closed_form import Array, RoughnessRule
from mipbake.prefilter.toksvig import excess

_DEAD_ZONE = 4e-5


def _widened(alpha2: Array, variance: Array) -> Array:
    v = np.maximum(excess(variance) - _DEAD_ZONE, 0)
    return np.asarray((alpha2 + 2 * v * np.maximum(1 - alpha2, 0)) / np.where(alpha2 < 1, 1 + 2 * v, 1))


UNREAL = RoughnessRule(
    name="unreal",
    summary="averages, roughness widened as by Unreal Engine's composite textures",
    averaged=lambda alpha2: np.sqrt(np.sqrt(alpha2)),
    restored=lambda rough: rough**4,
    widened=_widened,
    top_blur=2.0,
)
