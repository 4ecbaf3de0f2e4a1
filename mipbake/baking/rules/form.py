"""What a closed form is made of: what is read of texels, what of that is averaged, and what is made of averages.

Closed forms read much the same of a texel. So each says by keys what it reads, and whoever wants many forms of one
image reads and averages what they have in common once (together.py).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.rules.bands import Array, Image, texelwise_mean


class Whole:
    """An image that closed forms are wanted of, and what they measure of all of it: once for all forms.

    Args:
        stored: (H, W, C) stored channels, C-contiguous. model: the material model of the channels.
    """

    def __init__(self, stored: Image, model: str) -> None:
        self.stored, self.model = stored, model

    @cached_property
    def centre(self) -> NDArray[np.float32]:
        """(3,) the mean of the unit normals: moments about it are exact for flat maps, tilted ones too."""
        return texelwise_mean(material.model_named(self.model).unit_normals, self.stored)

    @cached_property
    def tilt(self) -> NDArray[np.float32]:
        """(2,) the mean slope: moments about it lose nothing to cancellation in tilted maps."""
        given = material.model_named(self.model)
        return texelwise_mean(lambda texels: slopes(given.unit_normals(texels)), self.stored)


class Texels:
    """Some texels, (..., C) stored channels, and what has been read of them."""

    def __init__(self, stored: Array) -> None:
        self.stored = stored
        self._known: dict[Hashable, Array] = {}

    def once(self, key: Hashable, read: Callable[[], Array]) -> Array:
        """What is read, by its key; the next caller is given the same array."""
        if key not in self._known:
            self._known[key] = read()
        return self._known[key]

    def normals(self, model: str) -> Array:
        """(..., 3) unit normals."""
        return self.once("unit normals", lambda: material.model_named(model).unit_normals(self.stored))

    def converted(self, source: str, target: str) -> Array:
        """(..., C) stored channels of another model."""
        return self.once(("stored", target), lambda: material.convert(self.stored, source, target))


@dataclass(frozen=True, eq=False)
class Part:
    """Something that is read of texels, and is averaged.

    Args:
        key: equal keys of forms of one image and one source stand for equal numbers.
        read: texels to (..., D). channels: which of D are averaged.
    """

    key: Hashable
    read: Callable[[Texels], Array]
    channels: Sequence[int]

    def of(self, texels: Texels) -> Array:
        """(..., D) what is read."""
        return texels.once(self.key, lambda: self.read(texels))


@dataclass(frozen=True, eq=False)
class Blur:
    """What is averaged over a wider box at level 0, where the box would leave it as it is.

    Args:
        width: of the box, in texels. channels: which of the averages are wanted so.
    """

    width: float
    channels: Sequence[int]


Write = Callable[[Array, "Array | None"], Array]
"""(..., D) averages, and blurred ones where a form asks for them at level 0, to (..., C) stored channels."""


@dataclass(frozen=True, eq=False)
class Form:
    """A closed form on an image.

    Args:
        parts: what is averaged, in the order in which `write` takes it.
        write: see Write. blur: None for none.
        unread: whether the averages are averages of the texels as they are stored.
    """

    parts: Sequence[Part]
    write: Write
    blur: Blur | None = None
    unread: bool = False


def slopes(normals: Array) -> Array:
    """(..., 2) of (..., 3) unit normals."""
    return normals[..., 0:2] / np.maximum(normals[..., 2:3], material.MIN_NORMAL_Z)


def stored_part(source: str, target: str, channels: Sequence[int]) -> Part:
    """Channels of the target as they are stored."""
    return Part(("stored", target), lambda texels: texels.converted(source, target), channels)
