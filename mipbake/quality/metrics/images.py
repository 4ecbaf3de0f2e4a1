"""Measures of images, a measure with its map, what displays show, and the checks that all measures of images share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mipbake.base.colour_science import colour_science
from mipbake.base.errors import UsageError
from mipbake.base.extras import extra
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
        """Mean of the map where `mask`, a boolean array of the map's shape, is true: a background dilutes the mean."""
        return float(self.per_pixel[mask].mean(dtype=np.float64))


def srgb_encode(linear: ImageArray) -> NDArray[np.float64]:
    """Linear Rec.709 to sRGB-encoded values in [0, 1], any shape, float64: what the display measures take.

    Values are clipped to [0, 1] first, as a display does. IEC 61966-2-1: 12.92 x up to 0.0031308, and above
    1.055 x^(1/2.4) - 0.055.
    """
    return linear_to_srgb(np.clip(np.asarray(linear, np.float64), 0, 1))


def displayed(linear: ImageArray) -> NDArray[np.float64]:
    """What a display shows of linear radiance, any shape, float64 in [0, 1): srgb_encode(x / (1 + x)), x at least 0.

    x / (1 + x) is the global operator of Reinhard et al. 2002, "Photographic tone reproduction for digital images",
    equation 3, by channel. Pictures, FLIP and SSIM of renders all use this transform. Negative values, which a pixel
    filter's lobes undershoot to, are black. x / (1 + x) has the precision of what is given; the encoding is in float64.
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
    """
    values = _colours("reference", reference, np.asarray(reference).dtype)
    if mask is not None:
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
    """Both images in `dtype`, (..., 3) of one shape, linear radiance that is finite and not negative; else UsageError,
    which says which image, which value and where."""
    advice = "expected linear radiance; clip at 0 what a filter's lobes undershot"
    return _checked(candidate, reference, dtype, math.inf, "negative", advice)


def checked_display(
    candidate: ImageArray, reference: ImageArray, dtype: DTypeLike = np.float64
) -> tuple[ImageArray, ImageArray]:
    """The same of sRGB-encoded values in [0, 1]."""
    advice = "expected sRGB-encoded colours; encode with srgb_encode"
    return _checked(candidate, reference, dtype, 1, "outside [0, 1]", advice)


def _checked(
    candidate: ImageArray, reference: ImageArray, dtype: DTypeLike, most: float, what: str, advice: str
) -> tuple[ImageArray, ImageArray]:
    both = _colours("candidate", candidate, dtype), _colours("reference", reference, dtype)
    check_same_shape(reference=both[1], candidate=both[0])
    for name, image in zip(("candidate", "reference"), both, strict=True):
        _refuse(name, image, (image < 0) | (image > most), what, advice)
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


def tonemapped_error(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean |s(p / (1 + p)) - s(r / (1 + r))| over colours and pixels, s the sRGB encoding: 0 is right, 1 the worst.

    What a display shows is as `displayed` has it. The reference's noise counts as error.

    Args:
        candidate, reference: (..., 3) linear radiance, one shape, from 0 up.
    """
    p, r = checked_radiance(candidate, reference)
    per_pixel = np.abs(displayed(p) - displayed(r)).mean(-1)
    return Measured(float(per_pixel.mean()), per_pixel.astype(np.float32))


THRESHOLD = 0.1
"""How much brighter than the reference a displayed value may be, in units of the displayed range."""


def false_sparkle(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean of max(0, P - R - THRESHOLD) over displayed, sRGB-encoded values: 0 is right, 0.9 the worst.

    It looks one way: what is too dark, and what is too bright by THRESHOLD or less, counts nothing. A dot that is
    brighter counts by how much it is, so few bright dots weigh as much as many faint ones. Each of the three channels
    is compared by itself, and a pixel has the mean of the three, so that red light where the reference has green counts
    as sparkle though both may have one luminance. Noise of the reference counts where it exceeds THRESHOLD.

    Args:
        candidate, reference: (..., 3) sRGB-encoded colours in [0, 1], one shape: pictures or whole films.
    """
    p, r = checked_display(candidate, reference)
    per_pixel = np.maximum(p - r - THRESHOLD, 0).mean(-1)
    return Measured(float(per_pixel.mean()), per_pixel.astype(np.float32))


WINDOW = 11
"""Pixels a side of the Gaussian window; smaller images have no SSIM."""


def structural_similarity(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean SSIM of what a display shows: 1 for the same image, at least -1. Symmetric in its images.

    Wang et al. 2004, "Image quality assessment: from error visibility to structural similarity", equation 13, with that
    paper's settings: Gaussian window of 11 x 11 pixels and sigma 1.5, K1 = 0.01, K2 = 0.03, range 1; by colour channel,
    averaged. The mean leaves out the 5 pixels at each border, where the window would leave the image; the map has them.

    Args:
        candidate, reference: (H, W, 3) sRGB-encoded colours in [0, 1], H and W at least 11.
    """
    with extra("compare", "SSIM"):
        from skimage import metrics

    p, r = checked_display(candidate, reference)
    check_picture(r, WINDOW)
    mean, values = metrics.structural_similarity(
        r, p, data_range=1, channel_axis=-1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    return Measured(float(mean), np.asarray(values.mean(-1), np.float32))


NITS_PER_UNIT = 203.0
"""Luminance in cd/m^2 of radiance 1: diffuse (reference) white of ITU-R BT.2408, for high dynamic range."""

MAX_NITS = 10_000.0
"""Where the encoding of SMPTE ST 2084 ends; brighter colours are clipped to it."""

_USER = "Delta E ITP"


def delta_e_itp(candidate: ImageArray, reference: ImageArray) -> Measured:
    """Mean Delta E ITP over the pixels, in just noticeable differences: 0 is right, below 1 nobody sees it.

    ITU-R BT.2124: 720 sqrt(dI^2 + dT^2 + dP^2) with T = C_T / 2, P = C_P, of colours in ICtCp (ITU-R BT.2100, PQ).
    Linear Rec.709 is scaled to cd/m^2, converted to BT.2020's primaries (one white point, no adaptation) and clipped at
    MAX_NITS. PQ is absolute, so the scale matters: the same ratio is more visible when bright. The reference's noise
    counts as error.

    Args:
        candidate, reference: (..., 3) linear Rec.709 radiance, one shape, from 0 up.
    """
    colour = colour_science(_USER)
    p, r = (_ictcp(image) for image in checked_radiance(candidate, reference))
    per_pixel = np.asarray(colour.delta_E(p, r, method="ITP"), np.float64)
    return Measured(float(per_pixel.mean()), per_pixel.astype(np.float32))


def _ictcp(image: ImageArray) -> NDArray[np.float64]:
    colour = colour_science(_USER)
    spaces = colour.RGB_COLOURSPACES
    matrix = np.asarray(colour.matrix_RGB_to_RGB(spaces["ITU-R BT.709"], spaces["ITU-R BT.2020"]), np.float64)
    nits = np.minimum(image * NITS_PER_UNIT @ matrix.T, MAX_NITS)
    return np.asarray(colour.RGB_to_ICtCp(nits, method="ITU-R BT.2100-2 PQ"), np.float64)
