"""What the image measures share: their arguments' checks, the sRGB encoding, and a measure with its map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mipbake.base.errors import UsageError
from mipbake.base.srgb import linear_to_srgb

ImageArray = NDArray[np.floating]
"""(..., 3) colours, float32 or float64; a picture is (H, W, 3), top row first."""


_MEDIAN_RADIANCE = 0.6  # what the median of a film's reference is brought to


@dataclass(frozen=True)
class Measured:
    """A measure with the map it is the mean of.

    Args:
        mean: the figure.
        per_pixel: one float32 value a pixel, the shape of the images without their colour axis.
    """

    mean: float
    per_pixel: NDArray[np.float32]

    def mean_over(self, mask: NDArray[np.bool_]) -> float:
        """Mean of the map where `mask`, a boolean array of the map's shape, is true: a background dilutes the mean.

        Raises:
            UsageError: another shape or dtype, or a mask that selects nothing.
        """
        mask = np.asarray(mask)
        if mask.shape != self.per_pixel.shape or mask.dtype != np.bool_:
            raise UsageError(
                f"mask is {mask.dtype} of shape {mask.shape}: expected bool of the map's shape {self.per_pixel.shape}"
            )
        if not mask.any():
            raise UsageError("mask selects no pixel: expected at least one to take the mean over")
        return float(self.per_pixel[mask].mean(dtype=np.float64))


def srgb_encode(linear: ImageArray) -> NDArray[np.float64]:
    """Linear Rec.709 to sRGB-encoded values in [0, 1], any shape, float64: what the display measures take.

    Values are clipped to [0, 1] first, as a display does. IEC 61966-2-1: 12.92 x up to 0.0031308, and above
    1.055 x^(1/2.4) - 0.055.
    """
    return linear_to_srgb(np.clip(np.asarray(linear, np.float64), 0, 1))


def displayed(linear: ImageArray) -> NDArray[np.float64]:
    """What a display shows of linear radiance, any shape, float64 in [0, 1): srgb_encode(x / (1 + x)), x at least 0.

    x / (1 + x) is the global operator of Reinhard et al. 2002, equation 3, by channel. Pictures, FLIP and SSIM of
    renders all use this transform. Negative values, which a pixel filter's lobes undershoot to, are black. x / (1 + x)
    has the precision of what is given; the encoding is in float64.
    """
    return srgb_encode(tonemapped(linear))


def tonemapped(linear: ImageArray) -> ImageArray:
    """The light that a display sends out for linear radiance, in [0, 1): x / (1 + x), as `displayed` encodes it; any
    shape, dtype kept."""
    x = np.maximum(linear, 0)
    light: ImageArray = x / (1 + x)
    return light


def tonemap_slope(linear: ImageArray) -> ImageArray:
    """The derivative of `tonemapped`, element by element, dtype kept; at 0 and below its value just above 0."""
    slope: ImageArray = 1 / np.square(1 + np.maximum(linear, 0))
    return slope


def film_exposure(reference: ImageArray, mask: NDArray[np.bool_] | None = None) -> float:
    """The exposure at which a film and its candidates are displayed: 0.6 over the reference's median.

    The median times the exposure is 0.6, which `displayed` takes to 0.6 / 1.6 = 0.375 before it encodes. One exposure
    serves all frames and all candidates: `displayed(film * exposure)`. The median is over all three channels, each
    value by itself, of all covered pixels of all frames; it is no luminance. Negative values, which a pixel filter's
    lobes undershoot to, are black. Where more than half of the values are black, their median says nothing: it is
    then taken over the values above 0.

    Args:
        reference: (..., 3) linear radiance, such as a film (T, H, W, 3).
        mask: boolean, the shape of the reference without its colour axis: which pixels the surface covers, all by
            default. A background would move the median.

    Raises:
        UsageError: other shapes, values that are not finite, or a reference without any light that counts.
    """
    values = _colours("reference", reference, np.asarray(reference).dtype)
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != values.shape[:-1] or mask.dtype != np.bool_:
            raise UsageError(
                f"mask is {mask.dtype} of shape {mask.shape}: expected bool of the reference's shape without its "
                f"colours, {values.shape[:-1]}"
            )
        values = values[mask]
    bright = values[values > 0]
    if not bright.size:
        raise UsageError("reference has no light in the pixels that count, so no exposure shows it: check its lights")
    median = float(np.median(np.maximum(values, 0)))
    return _MEDIAN_RADIANCE / (median if median > 0 else float(np.median(bright)))


def check_same_shape(**arrays: NDArray[np.generic]) -> None:
    """UsageError unless all arrays have the first one's shape; keywords are the names that the message uses."""
    (first, expected), *others = arrays.items()
    for name, array in others:
        if array.shape != expected.shape:
            raise UsageError(
                f"{name} has shape {array.shape} and {first} {expected.shape}: expected one shape, render both at "
                "the same resolution"
            )


def checked_radiance(
    candidate: ImageArray, reference: ImageArray, dtype: DTypeLike = np.float64
) -> tuple[ImageArray, ImageArray]:
    """Both images in `dtype`, checked: (..., 3), one shape, linear radiance, finite and not negative.

    Raises:
        UsageError: otherwise, saying which image, which value and where.
    """
    both = _colours("candidate", candidate, dtype), _colours("reference", reference, dtype)
    check_same_shape(reference=both[1], candidate=both[0])
    for name, image in zip(("candidate", "reference"), both, strict=True):
        _refuse(
            name, image, image < 0, "negative", "expected linear radiance; clip at 0 what a filter's lobes undershot"
        )
    return both


def checked_display(
    candidate: ImageArray, reference: ImageArray, dtype: DTypeLike = np.float64
) -> tuple[ImageArray, ImageArray]:
    """Both images in `dtype`, checked: (..., 3), one shape, sRGB-encoded values in [0, 1].

    Raises:
        UsageError: otherwise, saying which image, which value and where.
    """
    both = _colours("candidate", candidate, dtype), _colours("reference", reference, dtype)
    check_same_shape(reference=both[1], candidate=both[0])
    for name, image in zip(("candidate", "reference"), both, strict=True):
        outside = (image < 0) | (image > 1)
        _refuse(name, image, outside, "outside [0, 1]", "expected sRGB-encoded colours; encode with srgb_encode")
    return both


def check_picture(image: ImageArray, side: int = 1) -> None:
    """UsageError unless the image is (H, W, 3) with both sides of `side` pixels or more."""
    if image.ndim != 3 or min(image.shape[:2]) < side:
        raise UsageError(f"the images have shape {image.shape}: expected (H, W, 3), at least {side} pixels a side")


def _colours(name: str, image: ImageArray, dtype: DTypeLike) -> ImageArray:
    array = np.asarray(image)
    if array.dtype.kind != "f":
        raise UsageError(f"{name} is {array.dtype}: expected a floating-point array of colours")
    if array.ndim < 1 or array.shape[-1] != 3 or array.size == 0:
        raise UsageError(f"{name} has shape {array.shape}: expected (..., 3) colours, at least one")
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite and is refused below
        array = np.ascontiguousarray(array, dtype)
    _refuse(name, array, ~np.isfinite(array), "not finite", "expected finite colours")
    return array


def _refuse(name: str, image: ImageArray, bad: NDArray[np.bool_], what: str, advice: str) -> None:
    if bad.any():
        where = tuple(int(i) for i in np.unravel_index(int(bad.argmax()), bad.shape))
        count = int(bad.sum())
        values = "1 value that is" if count == 1 else f"{count} values that are"
        raise UsageError(f"{name} has {values} {what}, the first {image[where]:g} at index {where}: {advice}")
