"""`neural`: encode, downsample linearly in the latent space, decode (equation 1 of Kemppinen et al. 2023)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.prefilter import PrefilterResult
from mipbake.base.device import PROCESSOR, checked_device
from mipbake.base.errors import UsageError
from mipbake.base.timings import Progress
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import Wrap

if TYPE_CHECKING:
    from mipbake.models.registry import WeightsInfo


class Neural:
    """A trained network.

    Args:
        weights: name of the weights; None for the weights released as the default of the target and the pixel filter.
        sampler: that will look the stack up.
        device: where the network runs, as `mipbake.base.device.checked_device` takes it. Levels of different devices
            differ by rounding.

    Raises:
        UsageError: no weights of that name, or a device that cannot be used.
    """

    name = "neural"
    summary = "a trained network (pixel-filter-aware MIP maps)"
    averages = False
    own_memory = 0

    def __init__(self, weights: str | None = None, sampler: Sampler = DEFAULT_SAMPLER, device: str = PROCESSOR) -> None:
        self._chosen: WeightsInfo | None = None
        self.sampler, self.device = sampler, checked_device(device)
        if weights is not None:
            from mipbake.models.registry import find_weights

            self._chosen = find_weights(weights)

    def weights(self, target: str, pixel_filter: str, source: str = "gltf") -> WeightsInfo:
        """The weights that bakes of a source to a target use; UsageError where there are none for target and filter."""
        from mipbake.models.registry import default_weights

        info = self._chosen
        if info is None:
            return default_weights(target, pixel_filter, source=source)
        if not info.network.takes(source):
            raise UsageError(
                f"weights {info.name} read gltf and would lose what a set in {source} says of lobes; choose others, or "
                "leave them out"
            )
        if target not in info.targets or pixel_filter not in info.pixel_filters:
            raise UsageError(
                f"weights {info.name} are for material model {' or '.join(info.targets)} with pixel filter "
                f"{' or '.join(info.pixel_filters)}: expected some for {target} with {pixel_filter}; choose others, "
                "or leave them out"
            )
        return info

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter. UsageError where no weights were released for the target and the pixel filter, or the memory
        of the device is too small."""
        from mipbake.models.registry import load_baker

        info = self.weights(target, pixel_filter, source)
        baker = load_baker(info, self.device)
        levels = baker.bake(stored, source, target, pixel_filter, wrap, progress, self.sampler)
        return PrefilterResult(levels, info.name, info.sha256, sampler=self.sampler)
