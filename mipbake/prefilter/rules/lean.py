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
from numpy.typing import NDArray

from mipbake import directions, material
from mipbake.pixel_filter import Wrap
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.rules.averages import split, stored_channels
from mipbake.prefilter.rules.bands import Array, closed_form_levels, texelwise_mean


class Averages(NamedTuple):
    """What is averaged of a texel: channels of one image, by their names."""

    colours: Array
    """(..., A) the `averaged` channels of the target."""
    slopes: Array
    """(..., 2) their first moment, about the mean of the whole map."""
    tensor: Array
    """(..., 3) S + 2 ss^T of the slopes s."""


class Lean:
    """Slope moments: anisotropic for anisotropic targets, their mean eigenvalue for isotropic ones."""

    name = "lean"
    summary = "averages, with the variance of the slopes added to the roughness (LEAN mapping)"
    averages = True
    own_memory = 0

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter."""
        wanted = material.model_named(target)
        # A target with the lobe of `ggx` takes S from `ggx`, where alpha has its floor. Others have their own alpha.
        lobes_of = material.MODELS[material.COMMON] if wanted.lobe is material.GGX_LOBE else wanted
        # Moments about the mean slope of the whole map: a tilted map would leave its covariance to cancellation.
        tilt = texelwise_mean(lambda texels: _slopes(texels, source), stored)

        def read(texels: Array) -> Array:
            slopes = _slopes(texels, source) - tilt
            x, y = slopes[..., 0], slopes[..., 1]
            # Slopes reach 50 and their squares 2500: the moments add up in place, so one tensor carries S and slopes.
            own = material.convert(texels, source, target)
            lobes = material.convert(texels, source, lobes_of.name)
            tensor = material.full_tensor(lobes_of.roughness_tensor(lobes))
            tensor += 2 * np.stack([x * x, y * y, x * y], -1)
            return np.concatenate(Averages(own[..., wanted.averaged], slopes, tensor), -1)

        def write(channels: Array) -> Array:
            colours, slopes, second = Averages(*split(channels, len(wanted.averaged), 2))
            x, y = slopes[..., 0], slopes[..., 1]
            # Averages of S + 2 ss^T are positive definite in exact arithmetic, not after rounding.
            tensor = material.positive_definite(second - 2 * np.stack([x * x, y * y, x * y], -1), wanted.least_alpha2)
            normal = np.concatenate([slopes + tilt, np.ones_like(slopes[..., :1])], -1)
            return stored_channels(colours, normal, tensor, target)

        levels = closed_form_levels(stored, read, write, pixel_filter, wrap, progress)
        return PrefilterResult(directions.agreeing(levels, target, wrap))


def _slopes(stored: Array, model: str) -> Array:
    normal = material.model_named(model).unit_normals(stored)
    return normal[..., 0:2] / np.maximum(normal[..., 2:3], material.MIN_NORMAL_Z)
