"""Baking with a network of any architecture in torch, from weights as they are released."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from mipbake.models.architecture import Architecture, Baker
from mipbake.models.base import Network
from mipbake.pixel_filter import Wrap


@dataclass(frozen=True, eq=False)
class TorchBaker(Baker):
    """A network, ready for bakes."""

    network: Network

    def bake(
        self,
        stored: NDArray[np.float32],
        source: str,
        target: str,
        pixel_filter: str,
        wrap: Wrap,
        progress: Callable[[float], None],
        sampler: str,
    ) -> list[NDArray[np.float32]]:
        """See Baker."""
        return self.network.bake(stored, source, target, pixel_filter, wrap, progress, sampler)


def network_of(
    config: Architecture, tensors: Mapping[str, NDArray[np.float32]], pixel_filters: tuple[str, ...]
) -> Network:
    """A network with its weights, ready for inference; ValueError where the tensors do not fit the architecture."""
    network = config.build()
    try:
        network.load_state_dict({name: torch.from_numpy(each) for name, each in tensors.items()})
    except RuntimeError as error:
        raise ValueError(str(error)) from error
    network.pixel_filters = pixel_filters
    return network.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]
