"""The interface of losses: what a step draws, and how far a network is from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

from mipbake.models.base import Network

if TYPE_CHECKING:
    from typing_extensions import Self

TORUS = ("wrap", "wrap")


@dataclass(frozen=True)
class Batch:
    """Everything of one step that does not depend on the network; a loss adds fields of its own.

    Args:
        source: material model of the patches. patches: (B, S, S, C) stored channels.
    """

    source: str
    patches: Tensor

    def to(self, device: torch.device) -> Self:
        """The same on a device; itself where all of it is there."""
        return self if self.patches.device == device else mapped(self, lambda tensor: tensor.to(device))

    def tensors(self) -> list[Tensor]:
        """All tensors, in an order of their own."""
        found: list[Tensor] = []
        mapped(self, found.append)
        return found

    def kind(self) -> str:
        """What batches share that a network and a loss do the same with: everything but the numbers in tensors."""
        return repr(mapped(self, lambda tensor: (tensor.dtype, tuple(tensor.shape))))


_Part = TypeVar("_Part")


def mapped(part: _Part, change: Callable[[Tensor], object]) -> _Part:
    """Tensors, and tensors in what holds them, changed; anything else as it is."""
    made: Any = part
    if isinstance(part, Tensor):
        made = change(part)
    elif isinstance(part, tuple):
        each = [mapped(inner, change) for inner in part]
        made = type(part)(*each) if hasattr(part, "_fields") else tuple(each)
    elif isinstance(part, dict):
        made = {key: mapped(inner, change) for key, inner in part.items()}
    elif is_dataclass(part) and not isinstance(part, type):
        made = replace(part, **{field.name: mapped(getattr(part, field.name), change) for field in fields(part)})
    return cast(_Part, made)


AnyBatch = TypeVar("AnyBatch", bound=Batch)


class Loss(ABC, Generic[AnyBatch]):
    """One kind of loss, and its settings.

    A subclass is a frozen dataclass. Its fields are what the section [loss] of a configuration holds.
    """

    kind: ClassVar[str]
    """What configurations call it."""

    @property
    @abstractmethod
    def crops(self) -> int:
        """Material patches a step."""

    @property
    @abstractmethod
    def crop_size(self) -> int:
        """Their side in texels, a power of two."""

    @property
    @abstractmethod
    def pixel_filter(self) -> str:
        """The filter that validations measure with."""

    @property
    @abstractmethod
    def pairs(self) -> int:
        """Light-view pairs a patch."""

    @property
    def pixel_filters(self) -> tuple[str, ...]:
        """The filters that networks are trained for, the main one first."""
        return (self.pixel_filter,)

    @property
    def max_lod(self) -> int:
        """Last level of a patch, 1 x 1."""
        return self.crop_size.bit_length() - 1

    @property
    @abstractmethod
    def drawn(self) -> str:
        """How the pairs are drawn, for the model card."""

    @abstractmethod
    def draw(self, patches: Tensor, source: str, rng: np.random.Generator) -> AnyBatch:
        """The batch of (crops, S, S, C) patches of a material model."""

    @abstractmethod
    def value(self, network: Network, batch: AnyBatch) -> Tensor:
        """Predicts, renders and compares: the scalar loss of one batch, the mean over the models that are made."""
