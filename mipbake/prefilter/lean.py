"""`lean`: slope moments, after LEAN mapping (Olano and Baker 2010).

S' = mean(S) + 2 Cov(slopes), with slopes = (n_x, n_y) / n_z and S the roughness tensor (alpha^2 = 2 sigma^2 is what
turns a slope variance into GGX's and Beckmann's alpha). The new normal is that of the mean slope. Reflectances are
averaged. Moments are linear, so one pass of the averaging kernel filters everything.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.pixel_filter import Wrap, filtered_levels

_MIN_NORMAL_Z = 0.02
"""Slopes are cut at 50, where a normal is 89 degrees off: at the horizon they are infinite, averages must not be."""


class Lean:
    """Slope moments: anisotropic for anisotropic targets, their mean eigenvalue for isotropic ones."""

    name = "lean"
    summary = "averages, with the variance of the slopes added to the roughness (LEAN mapping)"

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter."""
        ggx = material.convert(stored, source, "ggx")
        # Reflectances are averaged in the target's own channels: base colour and metallic, or albedo and F0.
        own = material.convert(stored, source, target)
        colours = own[..., 0 : 6 if target == "ggx" else 4]
        normal = material.lift_normal(ggx[..., 6:8])
        slopes = normal[..., 0:2] / np.maximum(normal[..., 2:3], _MIN_NORMAL_Z)
        # Moments about the mean slope of the whole map: a tilted map would leave its covariance to cancellation.
        tilt = slopes.mean((0, 1))
        slopes = slopes - tilt
        squares = np.stack([slopes[..., 0] ** 2, slopes[..., 1] ** 2, slopes[..., 0] * slopes[..., 1]], -1)
        # Slopes reach 50 and their squares 2500: the moments add up in place, so one tensor carries S and slopes.
        moments = np.concatenate([colours, slopes, material.tensor_exp(ggx[..., 8:11]) + 2 * squares], -1)
        levels = filtered_levels(moments.astype(np.float32), pixel_filter, wrap, progress)
        levels = [_from_moments(level, tilt, target) for level in levels]
        return PrefilterResult(material.align_directions(levels) if target == "gltf-anisotropic" else levels)


def _from_moments(moments: NDArray[np.float32], tilt: NDArray[np.float32], target: str) -> NDArray[np.float32]:
    colours, slopes, second = moments[..., :-5], moments[..., -5:-3], moments[..., -3:]
    x, y = slopes[..., 0], slopes[..., 1]
    tensor = second - 2 * np.stack([x * x, y * y, x * y], -1)
    # Averages of S + 2 ss^T are positive definite in exact arithmetic; rounding may take the smaller axis below zero.
    smallest = np.float32(material.MIN_ROUGHNESS**4)
    tensor[..., 0:2] = np.maximum(tensor[..., 0:2], smallest)
    limit = np.sqrt(np.maximum((tensor[..., 0] - smallest / 2) * (tensor[..., 1] - smallest / 2), 0))
    tensor[..., 2] = np.clip(tensor[..., 2], -limit, limit)
    normal = np.concatenate([slopes + tilt, np.ones_like(slopes[..., :1])], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    if target == "ggx":
        channels = [colours, normal[..., 0:2], material.tensor_log(tensor)]
    elif target == "gltf-anisotropic":
        alpha, strength, direction = material.tensor_to_axes(tensor)
        channels = [colours, np.sqrt(alpha)[..., None], normal, direction, strength[..., None]]
    else:
        alpha2 = (tensor[..., 0:1] + tensor[..., 1:2]) / 2
        channels = [colours, np.clip(alpha2**0.25, 0, 1), normal]
    return material.regularise(np.concatenate(channels, -1).astype(np.float32), target)
