"""What an image is compared by: the radiance of its pixels, what a display shows of it, or its numbers as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.srgb import linear_to_srgb
from mipbake.fitting.renderer import Array
from mipbake.quality.metrics.images import film_exposure, tonemapped

ERRORS = ("both", "displayed", "plain")
"""What a fit can aim at. `both`: what a display shows, and linear radiance. `displayed`: what a display shows alone.
`plain`: the numbers of images as they are."""

_LOSS = 4.0
"""So many decibels that one part, or one scale, gains make up for one that another loses."""

LEAST_ERROR = 1e-9
"""A smaller share of an error counts as this, 90 dB: what 8 bits can hold ends before."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """One way to compare images of a view with its reference.

    Args:
        name: what scores call it.
        reference: (P, 3) the reference's pixels, as they are compared.
        exposure: what images are multiplied by before they are displayed; None where they are compared as they are.
        shown: (P,) 1 where a pixel shows the maps, and 0 where its error does not count.
        weight: one over the reference's sum of squares over these pixels: errors count as shares.
        started: the error, as a share, of the stack that a fit started from.
    """

    name: str
    reference: Array
    exposure: float | None
    shown: Array
    weight: float
    started: float = 1.0

    @staticmethod
    def of(name: str, pixels: Array, exposure: float | None, shown: Array) -> Comparison:
        """A comparison with a reference whose pixels (P, 3) hold radiance, or numbers as they are."""
        reference = pixels if exposure is None else displayed(pixels, exposure)
        energy = float(np.sum(np.square(reference, dtype=np.float64) * shown[:, None]))
        return Comparison(name, reference, exposure, shown, 1 / energy)

    def begun(self, pixels: Array) -> Comparison:
        """The same, with the pixels of the stack that a fit starts from."""
        return replace(self, started=max(self.error(pixels), LEAST_ERROR))

    def compared(self, pixels: Array) -> Array:
        """(P, 3) pixels of an image, as they are compared with the reference."""
        return pixels if self.exposure is None else displayed(pixels, self.exposure)

    def error(self, pixels: Array) -> float:
        """Sum of squared differences of the pixels (P, 3) of an image, as a share of the reference's sum of squares."""
        squares = np.square(self.compared(pixels) - self.reference, dtype=np.float64)
        return float(np.sum(squares * self.shown[:, None]) * self.weight)

    def scaled(self, compared: Array) -> Array:
        """What is compared, times a factor that makes the sum of squared differences the error as a share of that at
        the start."""
        return np.asarray(compared * np.float32(np.sqrt(self.weight / self.started)), np.float32)


def comparisons(error: str, pixels: Array, shown: Array) -> tuple[Comparison, ...]:
    """The comparisons of an aim.

    Args:
        error: a name in ERRORS.
        pixels: (P, 3) of the reference. shown: (P,) as in `Comparison`.
    """
    if error == "plain":
        return (Comparison.of("plain", pixels, None, shown),)
    display = Comparison.of("displayed", pixels, film_exposure(pixels[shown > 0]), shown)
    return (display,) if error == "displayed" else (display, Comparison.of("linear", pixels, None, shown))


def joined(parts: Sequence[Comparison], pixels: Sequence[Array]) -> Array:
    """(P, 3 parts) what all parts compare, side by side: the sum of squared differences is the sum of their errors,
    each as a share of its error at the start."""
    return np.concatenate([part.scaled(each) for part, each in zip(parts, pixels, strict=True)], -1)


def decibels(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """SNR in dB of errors that are shares of 1."""
    return np.asarray(-10 * np.log10(np.maximum(errors, LEAST_ERROR)))


def worth(gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """What gains are worth, in dB: their mean over the parts, where a loss counts several times.

    Args:
        gains: (..., parts) in dB; NaN where nothing is known, which a mean then is, too.
    """
    return np.asarray(np.where(gains < 0, _LOSS * gains, gains).mean(-1), np.float64)


def displayed(image: Array, exposure: float) -> Array:
    """`mipbake.quality.metrics.displayed` of exposed radiance, in float32, which takes a quarter of the time."""
    light: Any = tonemapped(image * np.float32(exposure))
    return np.asarray(linear_to_srgb(light), np.float32)
