"""Signals of MaterialX node graphs: every channel is an affine function of one channel of a texture, a constant, or
something that cannot be read, and why."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Texture:
    """An image node's file.

    Args:
        path: the file, or a pattern of tiles.
        node: the image node's name and kind.
        type: the type of the node: "float", "color3", ...
        colour_space: as the document names it; None where it says nothing.
        inherited: whether that is said of something around the node only.
        wrap: addressing along u and v: "wrap", "clamp", "mirror" or "constant".
        placement: everything that moves the texture over the surface; equal for textures that lie on each other.
    """

    path: Path
    node: str
    type: str
    colour_space: str | None
    inherited: bool
    wrap: tuple[str, str]
    placement: tuple[Any, ...]


@dataclass(frozen=True)
class Channel:
    """gain * texture[letter] + offset; offset alone without a texture; nothing where there is a `reason`."""

    texture: Texture | None = None
    letter: str = ""
    gain: float = 0.0
    offset: float = 0.0
    reason: str = ""

    @property
    def is_constant(self) -> bool:
        """Whether it is a known number."""
        return self.texture is None and not self.reason


@dataclass(frozen=True)
class Signal:
    """Channels, and for tangent-space normals that a normalmap node has decoded its scale."""

    channels: tuple[Channel, ...]
    normal_scale: tuple[float, ...] | None = None

    @property
    def reason(self) -> str:
        """Why it cannot be read; empty where it can."""
        return next((c.reason for c in self.channels if c.reason), "")

    @property
    def texture(self) -> Texture | None:
        """The one texture that all channels come from; None where there is none, or more than one."""
        several = {c.texture for c in self.channels}
        return several.pop() if len(several) == 1 else None

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """The values of a constant; None for anything else."""
        return tuple(c.offset for c in self.channels) if all(c.is_constant for c in self.channels) else None


LETTERS = {"float": "R", "vector2": "RG", "color3": "RGB", "vector3": "RGB", "color4": "RGBA", "vector4": "RGBA"}
"""The channels of a file that an image node of a type gives."""

POSITIONS = {letter: index for letters in ("rgba", "xyzw") for index, letter in enumerate(letters)}

Operation = Callable[[Channel, Channel], Channel]


def number(value: float) -> Channel:
    """A constant channel."""
    return Channel(offset=value)


def constant(*values: float) -> Signal:
    """A constant signal."""
    return Signal(tuple(number(v) for v in values))


def unread(reason: str) -> Signal:
    """A signal that cannot be read."""
    return Signal((Channel(reason=reason),))


def numbers(text: str) -> tuple[float, ...] | None:
    """The numbers that a value holds; None where it holds anything else, or a number that is not finite."""
    if text.strip() in ("true", "false"):
        return (float(text.strip() == "true"),)
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        return None
    return found if all(math.isfinite(each) for each in found) else None


def picked(signal: Signal, index: int) -> Signal:
    if signal.reason:
        return unread(signal.reason)
    if not 0 <= index < len(signal.channels):
        return unread(f"channel {index} of {len(signal.channels)}")
    return Signal((signal.channels[index],))


def taken(signal: Signal, letters: str) -> Signal:
    """A swizzle: letters of rgba or xyzw, and 0 and 1 for constants."""
    if not letters or signal.reason:
        return signal
    channels: list[Channel] = []
    for letter in letters:
        index = POSITIONS.get(letter, len(signal.channels))
        if letter in "01":
            channels.append(number(float(letter)))
        elif index < len(signal.channels):
            channels.append(signal.channels[index])
        else:
            return unread(f"the channels {letters}")
    return Signal(tuple(channels))


def converted(signal: Signal, kind: str) -> Signal:
    """The signal with as many channels as the type has: one is repeated, a missing alpha is 1, others are cut off."""
    count = len(LETTERS.get(kind, "RGB"))
    channels = signal.channels * count if len(signal.channels) == 1 else (*signal.channels, number(1))
    return Signal(channels[:count])


def each(operation: Operation, left: Signal, right: Signal, label: str) -> Signal:
    """An operation channel by channel; a single channel meets all of the other signal's."""
    if left.reason or right.reason:
        return unread(left.reason or right.reason)
    count = max(len(left.channels), len(right.channels))
    a, b = (s.channels * count if len(s.channels) == 1 else s.channels for s in (left, right))
    scale = left.normal_scale or right.normal_scale
    if scale is not None:
        return unread(f"{label} on normals")
    results = [operation(x, y) for x, y in zip(a, b, strict=False)]
    return unread(f"{label} of two textures") if any(r.reason for r in results) else Signal(tuple(results))


_TWO = Channel(reason="two textures")


def plus(a: Channel, b: Channel) -> Channel:
    if a.texture is not None and b.texture is not None:
        return _TWO
    varying = b if a.is_constant else a
    return replace(varying, offset=a.offset + b.offset)


def minus(a: Channel, b: Channel) -> Channel:
    return plus(a, replace(b, gain=-b.gain, offset=-b.offset))


def times(a: Channel, b: Channel) -> Channel:
    if a.is_constant:
        return replace(b, gain=a.offset * b.gain, offset=a.offset * b.offset)
    return times(b, a) if b.is_constant else _TWO
