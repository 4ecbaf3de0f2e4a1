"""`unreal`: after Unreal Engine's composite textures (normal map into roughness), with a dead zone.

With r = |mean unit normal| and v = max(0, (1 - r) / r - 4e-5):
alpha'^2 = (alpha^2 + 2 v (1 - alpha^2)) / (1 + 2 v (1 - alpha^2)), as the engine computes it. This is Toksvig's rule
with a dead zone. The engine takes another alpha than `toksvig` does, and blurs the normals of level 0.

alpha comes from the mean of the stored perceptual roughness, as the engine's texture has it. (For anisotropic materials
that is the tensor S^(1/4), averaged.)

The engine measures level 0 on a blurred copy of the normals, so that it is wider there too. The blur here is the 2 x 2
box of level 1 centred on the texel, weights 1/4, 1/2, 1/4 along each axis; the engine's own changed with its versions
(two taps, later five). A pixel filter other than the box is already a blur of this kind, and then nothing is added to
it. The normals that are stored are not blurred.
"""

from __future__ import annotations

import numpy as np

from mipbake.baking.rules.averages import RoughnessRule, perceptual
from mipbake.baking.rules.bands import Array
from mipbake.baking.rules.toksvig import excess, widened

_DEAD_ZONE = 4e-5  # Unreal Engine's own number


def _widened(alpha2: Array, variance: Array) -> Array:
    return widened(alpha2, np.maximum(excess(variance) - _DEAD_ZONE, 0))


UNREAL = RoughnessRule(
    name="unreal",
    summary="averages, roughness widened as by Unreal Engine's composite textures",
    averaged=perceptual,
    restored=lambda rough: rough**4,
    widened=_widened,
    top_blur=2.0,
)
