"""`neural`: encode, downsample linearly in the latent space, decode (equation 1 of Kemppinen et al. 2023)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.errors import UsageError
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.pixel_filter import Wrap

if TYPE_CHECKING:
    from mipbake.models.registry import WeightsInfo

_NETWORK_OF = {"gltf": "gltf", "gltf-anisotropic": "ggx", "ggx": "ggx"}
"""Material model whose network bakes each target; `gltf-anisotropic` is converted from `ggx`, texel by texel."""


class Neural:
    """A trained network.

    Args:
        weights: name of the weights; None for those released as the default of the target and the pixel filter.

    Raises:
        UsageError: no weights of that name.
    """

    name = "neural"
    summary = "a trained network (pixel-filter-aware MIP maps)"
    averages = False

    def __init__(self, weights: str | None = None) -> None:
        self._chosen: WeightsInfo | None = None
        if weights is not None:
            from mipbake.models.registry import find_weights

            self._chosen = find_weights(weights)

    def weights(self, target: str, pixel_filter: str) -> WeightsInfo:
        """The weights that bakes of a target use; UsageError where there are none for it and the pixel filter."""
        from mipbake.models.registry import default_weights

        model, info = _NETWORK_OF[target], self._chosen
        if info is None:
            return default_weights(model, pixel_filter)
        if (info.network.model, info.pixel_filter) != (model, pixel_filter):
            raise UsageError(
                f"weights {info.name} are for material model {info.network.model} with pixel filter "
                f"{info.pixel_filter}: expected some for {model} with {pixel_filter}; choose others, or leave them out"
            )
        return info

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
