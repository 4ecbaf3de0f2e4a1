"""What functions of stochastic gradients share: arguments, channels, contributions of pixels, and moments."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from mipbake.base.aligned import dense
from mipbake.base.arguments import REAL, checked, device_of, empty
from mipbake.base.errors import UsageError

MOST_CHANNELS = 64

ANY = (("any",),)
"""The shape of a list of numbers."""


def given(name: str, value: Any, *fits: Any) -> Any:
    """A value that is `checked`, as native code reads it."""
    checked(name, value, *fits)
    if device_of(value) == "meta":
        raise UsageError(f"{name} is on meta: expected the CPU or CUDA")
    return dense(value)


def zeros(like: Any, shape: tuple[int, ...], dtype: str | None = None) -> Any:
    """An array of zeros of the kind and on the device of another."""
    made = empty(like, shape, dtype)
    made[...] = 0
    return made


@dataclass(frozen=True)
class Channels:
    """What the channels of all elements have in common.

    Args:
        magnitude: how far each channel is perturbed, epsilon of equation 4; 0 for a channel that stays as it is. The
            paper takes the quantisation step of the format for texels, and what moves a vertex by 1 to 2 pixels.
        low, high: limits of each channel; both perturbed values and what `descend` makes lie within.
        lifted: the first of three channels that hold a unit vector as (n + 1) / 2; its z follows from x and y, so that
            its magnitude is 0. None: there is no such vector.

    Raises:
        UsageError: numbers of other lengths, that are not finite, or limits in the wrong order, or too close together.
    """

    magnitude: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    lifted: int | None = None

    def __post_init__(self) -> None:
        count = len(self.magnitude)
        if not 1 <= count <= MOST_CHANNELS or len(self.low) != count or len(self.high) != count:
            raise UsageError(
                f"channels have {count} magnitudes, {len(self.low)} lower and {len(self.high)} upper limits: expected "
                f"1 to {MOST_CHANNELS} of each"
            )
        for name in ("magnitude", "low", "high"):
            for number in getattr(self, name):
                if math.isnan(number) or (name == "magnitude" and not 0 <= number < math.inf):
                    raise UsageError(f"{name} holds {number}: expected numbers, and magnitudes from 0 on")
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise UsageError("a lower limit of channels lies above the upper one: expected low <= high")
        ranges = zip(self.magnitude, self.low, self.high, strict=True)
        if any(high - low < 2 * magnitude for magnitude, low, high in ranges):
            raise UsageError("limits of a channel lie closer together than 2 magnitudes: expected room for both signs")
        if self.lifted is not None and not (0 <= self.lifted <= count - 3 and self.magnitude[self.lifted + 2] == 0):
            raise UsageError(
                f"lifted is {self.lifted}: expected the first of three channels, the third with a magnitude of 0"
            )


@dataclass(frozen=True, eq=False)
class Contributions:
    """For each element the pixels that show it, from `contributions`.

    Args:
        elements: (K,) int32, increasing: the elements that some pixel shows.
        starts: (K + 1,) int64: where the pixels of each begin.
        pixels: int32: numbers of pixels, increasing for each element.
    """

    elements: Any
    starts: Any
    pixels: Any


@dataclass(frozen=True, eq=False)
class Moments:
    """What Adam remembers of each element, from `Moments.of(values)`.

    Args:
        first, second: (N, C), the dtype of values.
        steps: (N,) int32, how often an element has been updated. Elements that no pixel showed stand still.
    """

    first: Any
    second: Any
    steps: Any

    @classmethod
    def of(cls, values: Any) -> Moments:
        """Moments of elements that have never been updated."""
        shape = tuple(given("values", values, None, REAL, (("N", "C"),)).shape)
        return cls(zeros(values, shape), zeros(values, shape), zeros(values, shape[:1], "int32"))
