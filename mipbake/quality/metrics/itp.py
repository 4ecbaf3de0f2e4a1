"""Delta E ITP: colour difference for high dynamic range, through colour-science."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour_science import colour_science
from mipbake.base.errors import UsageError
from mipbake.quality.metrics.images import ImageArray, Measured, checked_radiance

NITS_PER_UNIT = 203.0
"""Luminance in cd/m^2 of radiance 1: diffuse (reference) white of ITU-R BT.2408, for high dynamic range."""

MAX_NITS = 10_000.0
"""Where the encoding of SMPTE ST 2084 ends; brighter colours are clipped to it."""

_USER = "Delta E ITP"


def delta_e_itp(candidate: ImageArray, reference: ImageArray, nits_per_unit: float = NITS_PER_UNIT) -> Measured:
    """Mean Delta E ITP over the pixels, in just noticeable differences: 0 is right, below 1 nobody sees it.

    ITU-R BT.2124: 720 sqrt(dI^2 + dT^2 + dP^2) with T = C_T / 2, P = C_P, of colours in ICtCp (ITU-R BT.2100, PQ).
    Linear Rec.709 is scaled to cd/m^2, converted to BT.2020's primaries (one white point, no adaptation) and clipped at
    MAX_NITS. PQ is absolute, so the scale matters: the same ratio is more visible when bright. The reference's noise
    counts as error.

    Args:
        candidate, reference: (..., 3) linear Rec.709 radiance, one shape, from 0 up.
        nits_per_unit: cd/m^2 of radiance 1, above 0; an exposure belongs in here.

    Returns:
        The mean and the map, one Delta E a pixel.

    Raises:
        UsageError: other shapes, values that are negative or not finite, no positive nits_per_unit, or colour-science
            missing.
    """
    if not 0 < nits_per_unit < math.inf:
        raise UsageError(f"nits_per_unit is {nits_per_unit}: expected a number above 0, for example {NITS_PER_UNIT:g}")
    colour = colour_science(_USER)
    p, r = (_ictcp(image, nits_per_unit) for image in checked_radiance(candidate, reference))
    per_pixel = np.asarray(colour.delta_E(p, r, method="ITP"), np.float64)
    return Measured(float(per_pixel.mean()), per_pixel.astype(np.float32))


def _ictcp(image: ImageArray, nits_per_unit: float) -> NDArray[np.float64]:
    colour = colour_science(_USER)
    spaces = colour.RGB_COLOURSPACES
    matrix = np.asarray(colour.matrix_RGB_to_RGB(spaces["ITU-R BT.709"], spaces["ITU-R BT.2020"]), np.float64)
    nits = np.minimum(image * nits_per_unit @ matrix.T, MAX_NITS)
    return np.asarray(colour.RGB_to_ICtCp(nits, method="ITU-R BT.2100-2 PQ"), np.float64)
