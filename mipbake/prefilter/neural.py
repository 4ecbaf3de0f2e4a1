"""`neural`: encode, downsample linearly in the latent space, decode (equation 1 of Kemppinen et al. 2023)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.pixel_filter import Wrap

if TYPE_CHECKING:
    from mipbake.models.registry import WeightsInfo

_NETWORK_OF = {"gltf": "gltf", "gltf-anisotropic": "ggx", "ggx": "ggx"}
"""Material model whose network bakes each target; `gltf-anisotropic` is converted from `ggx`, texel by texel."""


class Neural:
    """A trained network, with the released weights of the target's model and the pixel filter."""

    name = "neural"
    summary = "a trained network (pixel-filter-aware MIP maps)"
    averages = False

    def weights(self, target: str, pixel_filter: str) -> WeightsInfo:
        """The weights that bakes of a target use; UsageError where none were released for it and the pixel filter."""
        from mipbake.models.registry import default_weights

        return default_weights(_NETWORK_OF[target], pixel_filter)

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter. UsageError where no weights were released for the target and the pixel filter."""
        from mipbake.models.inference import bake_levels
        from mipbake.models.registry import load_network

        model = _NETWORK_OF[target]
        info = self.weights(target, pixel_filter)
        network = load_network(info)
        channels = np.ascontiguousarray(material.convert(stored, source, model))
        levels = bake_levels(network, channels, wrap, progress=progress)
        if target != model:
            levels = material.align_directions([material.convert(level, model, target) for level in levels])
        levels = [material.regularise(level, target) for level in levels]
        return PrefilterResult(levels, info.name, info.sha256)
