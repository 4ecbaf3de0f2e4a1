"""FLIP and HDR-FLIP: the difference seen when alternating between two images, by the authors' package flip-evaluator.

The package is handed only what it takes: it reads NaN as no difference, an exposure count of 1 as no error, and ends
the process where the first exposure lies above the last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.base.extras import extra
from mipbake.quality.metrics.images import ImageArray, Measured, check_picture, checked_display, checked_radiance

PIXELS_PER_DEGREE = 3840 * math.pi / 180
"""About 67.02, FLIP's own default: a 0.7 m wide display of 3840 pixels seen from 0.7 m."""

_ACES = (0.36 * 2.51, 0.6 * 0.03, 0.0), (0.36 * 2.43, 0.6 * 0.59, 0.14)
"""Numerator and denominator, highest power first: Narkowicz's fit of the ACES curve at 0.6 times the exposure."""

_BRIGHT = 0.85  # the tonemapped value that the brightest pixel has at the first exposure, the median at the last
_DARKEST = float(np.finfo(np.float32).eps)  # luminance below which the package takes no median


@dataclass(frozen=True)
class Exposures:
    """Exposures of HDR-FLIP, in stops: `count` of them, 2 or more, evenly spaced from `start` to `stop`, both
    included."""

    start: float
    stop: float
    count: int


def hdr_flip_exposures(reference: ImageArray) -> Exposures:
    """The exposures that HDR-FLIP looks through, from the reference's luminance alone.

    Andersson et al. 2021: c_start = log2(x / Y_max) and c_stop = log2(x / Y_median), where the tone mapper takes x to
    0.85; max(2, ceil(c_stop - c_start)) exposures. Where more than half of the values are black their median says
    nothing: it is then taken over the others (the package takes 2^-23, some twenty exposures that show noise). Renders
    with a background should pass `reference[mask]`.

    Args:
        reference: (..., 3) linear radiance from 0 up.
    """
    values, _ = checked_radiance(reference, reference)
    luminance = np.sort((values @ np.array([0.2126, 0.7152, 0.0722])).reshape(-1))
    if luminance[-1] <= 0:
        raise UsageError("reference is black everywhere, so HDR-FLIP finds no exposures in it: pass them as exposures=")
    if luminance[len(luminance) // 2] == 0:
        luminance = luminance[luminance > 0]
    median = max(float(luminance[len(luminance) // 2]), _DARKEST)
    top, bottom = np.array(_ACES[0]), np.array(_ACES[1])
    x = float(np.roots(top - _BRIGHT * bottom).real.max())
    start = math.log2(x / float(luminance[-1]))
    stop = max(start, math.log2(x / median))
    return Exposures(start, stop, max(2, math.ceil(stop - start)))


def ldr_flip(candidate: ImageArray, reference: ImageArray, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Measured:
    """FLIP of what a display shows: mean of the map, 0 (no difference) to 1. Symmetric in its images.

    Andersson et al. 2020, "FLIP: a difference evaluator for alternating images": Delta E = (Delta E_c)^(1 - Delta E_f),
    with Delta E_c the colour difference after the eye's contrast sensitivity and Delta E_f the difference of edges and
    points.

    Args:
        candidate, reference: (H, W, 3) sRGB-encoded colours in [0, 1].
        pixels_per_degree: of visual angle, above 0. The more, the finer the detail that the eye averages.
    """
    p, r = checked_display(candidate, reference, np.float32)
    return _evaluate(p, r, "LDR", pixels_per_degree, {})


def hdr_flip(candidate: ImageArray, reference: ImageArray, exposures: Exposures | None = None) -> Measured:
    """HDR-FLIP: FLIP at several exposures, tonemapped with ACES; the map holds each pixel's worst. 0 to 1.

    Andersson et al. 2021, "Visualizing errors in rendered high dynamic range images". Not symmetric unless
    `exposures` are given: they come from the reference. Each exposure costs as much as one FLIP.

    Args:
        candidate, reference: (H, W, 3) linear radiance, from 0 up.
        exposures: default hdr_flip_exposures(reference).
    """
    p, r = checked_radiance(candidate, reference, np.float32)
    chosen = exposures or hdr_flip_exposures(r)
    parameters = {"startExposure": chosen.start, "stopExposure": chosen.stop, "numExposures": chosen.count}
    return _evaluate(p, r, "HDR", PIXELS_PER_DEGREE, {**parameters, "tonemapper": "aces"})


def _evaluate(
    candidate: ImageArray, reference: ImageArray, kind: str, pixels_per_degree: float, parameters: dict[str, object]
) -> Measured:
    check_picture(reference)
    if not 0 < pixels_per_degree < math.inf:
        raise UsageError(f"pixels_per_degree is {pixels_per_degree}: expected a number above 0, for example 67")
    with extra("compare", "FLIP"):
        import flip_evaluator

    given = {"ppd": float(pixels_per_degree), **parameters}
    # The package refuses read-only arrays, and contiguous input passes the checks uncopied.
    writable = (array if array.flags.writeable else array.copy() for array in (reference, candidate))
    evaluated = flip_evaluator.evaluate(*writable, kind, applyMagma=False, computeMeanError=False, parameters=given)
    per_pixel = evaluated[0][..., 0]
    return Measured(float(per_pixel.mean(dtype=np.float64)), np.array(per_pixel, np.float32))
