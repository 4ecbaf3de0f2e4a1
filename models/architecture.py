"""What an architecture is: the numbers that fix a network, and what is known of them without torch.

An architecture has two files: one like latent_config.py, which loads no torch, so that weights are listed quickly, and
one like latent_network.py. `ARCHITECTURES` in architectures.py lists the first.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError
from mipbake.material import MODELS, convert, directions, losses, model_named, regularise
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.pixel_filter import Wrap, filter_named
from mipbake.models.level_filter import Lookup

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from mipbake.models.base import Network

Tensors: TypeAlias = Mapping[str, NDArray[np.float32]]
"""Weights, by the names that the network's state has."""

Levels: TypeAlias = list[NDArray[np.float32]]
"""(H_L, W_L, C) stored channels of every level, down to 1 x 1."""


@dataclass(frozen=True)
class Description:
    """What the model card of released weights says of their architecture.

    Args:
        method: where the method comes from. encoder, latents, decoder: what each is made of.
    """

    method: str
    encoder: str
    latents: str
    decoder: str


class Baker(ABC):
    """What bakes: a network in torch, or released weights in the native core."""

    config: Architecture
    pixel_filters: tuple[str, ...]
    """The pixel filters that the weights were trained for; () where nothing says so."""

    def bake(
        self,
        stored: NDArray[np.float32],
        source: str,
        target: str,
        pixel_filter: str,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
        sampler: Sampler = DEFAULT_SAMPLER,
    ) -> Levels:
        """Every level of the stack of (H, W, C) stored channels of a source, as valid channels of the target.

        A source that is not read is converted to the nearest model that is, and a target that is not made is converted
        from one that is. Any size, without gradients.

        Args:
            wrap: wrap mode along u and along v.
            progress: called with the finished share, from 0 to 1.
            sampler: that will look the levels up, for networks that take it.

        Raises:
            UsageError: these weights do not make the target, do not take the source, or not for that pixel filter.
        """
        config, kernel = self.config, filter_named(pixel_filter).name
        if not config.takes(source):
            read = ", ".join(config.encoders)
            raise UsageError(
                f"these weights read {read} and would lose what {source} says of lobes; choose other weights"
            )
        if self.pixel_filters and kernel not in self.pixel_filters:
            filters = f"filter{'s' if len(self.pixel_filters) > 1 else ''} {', '.join(self.pixel_filters)}"
            raise UsageError(f"these weights are trained for the pixel {filters}, not for {kernel!r}")
        read, made = config.read_as(source), config.made_from(target)
        lookup = Lookup(kernel, config.taken(sampler))
        levels = self.levels(convert(stored, source, read), read, made, lookup, wrap, progress)
        return config.finished(levels, made, target, wrap)

    @abstractmethod
    def levels(
        self,
        stored: NDArray[np.float32],
        read: str,
        made: str,
        lookup: Lookup,
        wrap: Wrap,
        progress: Callable[[float], None] = lambda _: None,
    ) -> Levels:
        """`bake` from a model that is read, one of the encoders', to one that is made, one of the decoders'.

        Args:
            lookup: what the levels are for.
        """


class Architecture(ABC):
    """One kind of network, and the numbers that fix it.

    A subclass is a frozen dataclass. Its fields are what a description of weights and the section [network] of a
    configuration hold: texts, whole numbers, true or false, and tuples of texts.
    """

    architecture: ClassVar[str]
    """What descriptions of weights and configurations call the kind."""

    trained_with: ClassVar[str]
    """The kind of loss that its networks are trained with (mipbake.training.losses)."""

    @property
    @abstractmethod
    def encoders(self) -> tuple[str, ...]:
        """The material models that are read."""

    @property
    @abstractmethod
    def decoders(self) -> tuple[str, ...]:
        """The material models that are made."""

    @abstractmethod
    def build(self) -> Network:
        """A network of this architecture, as it is initialised."""

    def baker(self, tensors: Tensors, pixel_filters: tuple[str, ...], device: str = PROCESSOR) -> Baker:
        """What bakes on a device with weights that were trained for some pixel filters: the network in torch, unless an
        architecture has something faster.

        Raises:
            KeyError, ValueError: the tensors do not fit the architecture.
        """
        from mipbake.models.base import network_of

        return network_of(self, tensors, pixel_filters).to(device)

    def describe(self) -> Description | None:
        """For the model card; None where networks of this architecture are compared with and never released."""
        return None

    @property
    def models(self) -> tuple[str, ...]:
        """Every material model that is read or made, once."""
        return tuple(dict.fromkeys((*self.encoders, *self.decoders)))

    @property
    def targets(self) -> tuple[str, ...]:
        """The material models that can be baked: the models of the decoders, and models that are made from them."""
        converted = (name for name, model in MODELS.items() if model.decoded_from in self.decoders)
        return tuple(dict.fromkeys((*self.decoders, *converted)))

    def read_as(self, source: str) -> str:
        """The model that materials of a source are read in: their own, or the nearest one, after conversion."""
        if source in self.encoders:
            return source
        return min(self.encoders, key=lambda model: (losses(source, model), list(MODELS).index(model)))

    def made_from(self, target: str) -> str:
        """The decoder whose texels become a target; UsageError where there is none."""
        for model in (target, model_named(target).decoded_from):
            if model in self.decoders:
                return str(model)
        raise UsageError(f"these weights make {', '.join(self.targets)}, not {target!r}; choose other weights")

    def reads(self, source: str) -> bool:
        """Whether all of a source is seen, as it is or converted: who reads `gltf` is blind to anisotropic lobes."""
        return any(not losses(source, model).blind for model in self.encoders)

    def takes(self, source: str) -> bool:  # noqa: ARG002
        """Whether a source is baked at all."""
        return True

    def taken(self, sampler: Sampler) -> Sampler | None:  # noqa: ARG002
        """The sampler, where networks take it; else None."""
        return None

    def finished(self, levels: Levels, made: str, target: str, wrap: Wrap) -> Levels:
        """Levels of a model that is made, as a target stores them."""
        if made == target:
            return levels
        converted = [regularise(convert(level, made, target), target) for level in levels]
        return directions.agreeing(converted, target, wrap)


PAPER = "Kemppinen, Aittala and Lehtinen: Data-driven Pixel Filter Aware MIP Maps for SVBRDFs, 2023"


def layers(count: int, size: str, growth: int) -> str:
    """What a model card says of dense layers."""
    return f"{count} layers of {size}, {growth} new maps in each"


def check_counts(config: DataclassInstance) -> None:
    """UsageError where a field that counts something is no whole number, or below 1."""
    for field in fields(config):
        value: Any = getattr(config, field.name)
        if field.type == "int" and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
            raise UsageError(f"network.{field.name} must be a whole number of at least 1, got {value!r}")
