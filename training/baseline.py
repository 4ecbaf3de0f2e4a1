"""Baselines: networks of somebody else's design, trained as `mipbake-1` is, to be compared with it.

They belong to the benchmarks and are not installed. A script that has one gives it a name with `add_baseline`; from
then on configurations and checkpoints of that process may have it as their `architecture`. Everything else of a
training is the same: data, the balanced loss, optimiser, checkpoints, logs. Baselines cannot be exported as weights.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from torch import Tensor, nn

from mipbake.models.config import ARCHITECTURES, AnyConfig
from mipbake.models.moment_network import MomentNetwork
from mipbake.models.network import Network
from mipbake.models.registry import untrained


@dataclass(frozen=True)
class BaselineConfig(ABC):
    """Architecture of a baseline; subclasses are frozen dataclasses of what a TOML section can hold."""

    @property
    def encoders(self) -> tuple[str, ...]:
        """The material model that is read, the same as for the balanced loss."""
        return ("gltf",)

    @property
    @abstractmethod
    def decoders(self) -> tuple[str, ...]:
        """The one material model that is made."""

    @property
    def models(self) -> tuple[str, ...]:
        """The material models that are read or made, each once."""
        return tuple(dict.fromkeys((*self.encoders, *self.decoders)))

    @abstractmethod
    def build(self) -> BaselineNetwork:
        """A network of that architecture, as it is initialised."""


class BaselineNetwork(nn.Module, ABC):
    """What the balanced loss needs of a network.

    Args:
        config: the architecture.
    """

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__()
        self.config = config

    @abstractmethod
    def forward(self, stored: Tensor, pixel_filter: str) -> list[Tensor]:
        """(B, S, S, 8) stored channels of `gltf` of images that repeat, S a power of two, to every level.

        Returns:
            (B, S_L, S_L, C) valid stored channels of the model that is made, down to 1 x 1; differentiable.
        """


TrainableConfig: TypeAlias = AnyConfig | BaselineConfig
Trainable: TypeAlias = Network | MomentNetwork | BaselineNetwork

_BASELINES: dict[str, type[BaselineConfig]] = {}


def add_baseline(name: str, kind: type[BaselineConfig]) -> None:
    """Lets configurations and checkpoints of this process name a baseline as their `architecture`."""
    _BASELINES[name] = kind


def architectures() -> Mapping[str, type[TrainableConfig]]:
    """What can be trained, by the name that configurations have for it."""
    return {**ARCHITECTURES, **_BASELINES}


def new_network(config: TrainableConfig) -> Trainable:
    """A network of that architecture, as it is initialised."""
    return config.build() if isinstance(config, BaselineConfig) else untrained(config)
