"""The interface of networks: everything that training and baking ask of one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.models.architecture import Architecture, Baker, Tensors

Stacks: TypeAlias = Mapping[str, list[Tensor]]
"""Material models that are made, and all levels of a stack of each."""

Patches: TypeAlias = Callable[[str], NDArray[np.float32]]
"""(N, S, S, C) stored channels of a material model, random samples of the materials to train on."""


class Network(nn.Module, Baker):
    """A network of any architecture. Images are (B, H, W, channels); those that `bake` takes are (H, W, channels)."""

    def __init__(self, config: Architecture) -> None:
        super().__init__()
        self.config = config
        self.pixel_filters = ()

    @property
    def device(self) -> torch.device:
        """Where its parameters lie. It bakes there."""
        return next(self.parameters()).device

    @abstractmethod
    def forward(self, stored: Tensor, source: str, pixel_filter: str, sampler: Sampler = DEFAULT_SAMPLER) -> Stacks:
        """Every level of the stacks of every model that is made; differentiable in the parameters.

        Args:
            stored: (B, S, S, C) stored channels of images that repeat, S a power of two.
            source: the model of the images, one of the encoders'.
            pixel_filter: that the levels are for. sampler: that will look them up, for networks that take it.

        Returns:
            (B, S_L, S_L, C) valid stored channels each, down to 1 x 1.
        """

    def fit(self, patches: Patches) -> None:
        """Takes what a training leaves as it is, such as a whitening, from materials; before the first step."""

    def only_of(self, parameter: str) -> str:  # noqa: ARG002
        """The source whose steps alone train a parameter of that name; "" for the steps of every source."""
        return ""


def network_of(config: Architecture, tensors: Tensors, pixel_filters: tuple[str, ...]) -> Network:
    """A network with its weights, ready for inference; ValueError where the tensors do not fit the architecture."""
    network = config.build()
    try:
        network.load_state_dict({name: torch.from_numpy(each) for name, each in tensors.items()})
    except RuntimeError as error:
        raise ValueError(str(error)) from error
    network.pixel_filters = pixel_filters
    return network.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]
