"""`lean`: slope moments, after LEAN mapping (Olano and Baker 2010).

S' = mean(S) + 2 Cov(slopes), with slopes = (n_x, n_y) / n_z and S the roughness tensor (alpha^2 = 2 sigma^2 is what
turns a slope variance into GGX's and Beckmann's alpha). The new normal has the mean slope. Reflectances are
averaged, and so is g of `beckmann`, though the rule is derived for g = 0 (as in section 4 of Kemppinen et al. 2023).
Moments are linear, so one pass of the averaging kernel filters everything. Isotropic targets take the mean eigenvalue
of S'.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mipbake import material
from mipbake.baking.rules.averages import split, stored_channels
from mipbake.baking.rules.bands import Array
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Form, Part, Texels, Whole, slopes, stored_part


class Averages(NamedTuple):
    """What is averaged of a texel: channels of one image, by their names."""

    colours: Array
    """(..., A) the `averaged` channels of the target."""
    slopes: Array
    """(..., 2) their first moment, about the mean of the whole map."""
    tensor: Array
    """(..., 3) S + 2 ss^T of the slopes s."""


class Lean(ClosedForm):
    """Slope moments: anisotropic for anisotropic targets, their mean eigenvalue for isotropic ones."""

    name = "lean"
    summary = "averages, with the variance of the slopes added to the roughness (LEAN mapping)"

    def form(self, whole: Whole, target: str) -> Form:
        """See ClosedForm."""
        source, wanted = whole.model, material.model_named(target)
        # A target with the lobe of `ggx` takes S from `ggx`, where alpha has its floor. Others have their own alpha.
        lobes_of = material.MODELS[material.COMMON] if wanted.lobe is material.GGX_LOBE else wanted
        # Moments about the mean slope of the whole map: a tilted map would leave its covariance to cancellation.
        tilt = whole.tilt

        def tilted(texels: Texels) -> Array:
            return slopes(texels.normals(source)) - tilt

        first = Part("slopes", tilted, range(2))

        def tensor(texels: Texels) -> Array:
            at = first.of(texels)
            x, y = at[..., 0], at[..., 1]
            # Slopes reach 50 and their squares 2500: the moments add up in place, so one tensor carries S and slopes.
            out = material.full_tensor(lobes_of.roughness_tensor(texels.converted(source, lobes_of.name)))
            out += 2 * np.stack([x * x, y * y, x * y], -1)
            return out

        def write(channels: Array, _: Array | None) -> Array:
            colours, at, second = Averages(*split(channels, len(wanted.averaged), 2))
            x, y = at[..., 0], at[..., 1]
            # Averages of S + 2 ss^T are positive definite in exact arithmetic, not after rounding.
            spread = material.positive_definite(second - 2 * np.stack([x * x, y * y, x * y], -1), wanted.least_alpha2)
            normal = np.concatenate([at + tilt, np.ones_like(at[..., :1])], -1)
            return stored_channels(colours, normal, spread, target)

        colours = stored_part(source, target, wanted.averaged)
        return Form([colours, first, Part(("lean", lobes_of.name), tensor, range(3))], write)
