"""Flicker: how much a sequence of frames changes, beside how much the reference says it should.

Frames are either two renders half a pixel apart or consecutive steps of a slow motion. A candidate that shimmers
changes more than the reference, a blurred one less; one that changes as much, but elsewhere, has a low SNR of the
change.

Values are linear radiance, or what a display shows of it (`displayed`, for films that people see). A display's curve
bends, so two independent estimates A and B of the radiance are displayed each by itself, and then taken. Their noise
still drops out of products. What stays is the bend's bias, half the curve's second derivative times the variance of
the noise, so the noise should be small: films bound it as renders do.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.quality.metrics.images import ImageArray, check_same_shape
from mipbake.quality.metrics.snr import snr_db

# Share of the noise energy in the reference's change. Chance reaches it below 10^4 values or so.
_RESOLVED = 0.05


def flicker_ratio(candidate: ImageArray, first: ImageArray, second: ImageArray) -> float:
    """Mean squared change of the candidate over the mean squared change of the reference: 1 is right, more shimmers,
    less is blurred.

    sum (P_t+1 - P_t)^2 / sum (A_t+1 - A_t)(B_t+1 - B_t), with A and B two independent unbiased estimates of the
    reference, whose product holds no bias from their noise (see snr_db). Pass one array twice where there is no noise.

    Args:
        candidate, first, second: (T, ...) frames of linear radiance, or of displayed values, one shape, T at least 2.

    Returns:
        The ratio, from 0 up; nan where the reference's change is below a twentieth of its noise, where more samples are
        needed to see it, and where nothing changes at all.
    """
    return float(flicker_ratio_from_sums(flicker_sums(candidate, first, second)))


def flicker_snr_db(candidate: ImageArray, first: ImageArray, second: ImageArray) -> float:
    """SNR of the change itself, in dB: snr_db of the differences of consecutive frames; arguments as flicker_ratio."""
    return snr_db(*_changes(candidate, first, second))


def flicker_sums(candidate: ImageArray, first: ImageArray, second: ImageArray) -> NDArray[np.float64]:
    """(3,) the sums that flicker_ratio divides: the candidate's squared change, the reference's, and the noise energy
    in the reference's. Sums of light-view pairs add up."""
    p, a, b = (change.reshape(-1) for change in _changes(candidate, first, second))
    return np.stack([np.square(p).sum(), (a * b).sum(), np.square(a - b).sum() / 2])


def flicker_ratio_from_sums(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) sums, or sums of rows of them, to (...) ratios, nan where the reference's change is not resolved."""
    changed, expected, noise = np.moveaxis(np.asarray(sums, np.float64), -1, 0)
    resolved = expected > _RESOLVED * noise
    return np.where(resolved, changed / np.where(resolved, expected, 1), math.nan)


def _changes(candidate: ImageArray, first: ImageArray, second: ImageArray) -> tuple[NDArray[np.float64], ...]:
    frames = {"candidate": candidate, "first": first, "second": second}
    arrays = {name: np.asarray(value, np.float64) for name, value in frames.items()}
    check_same_shape(**arrays)
    if arrays["candidate"].ndim < 2 or len(arrays["candidate"]) < 2:
        raise UsageError(f"the frames have shape {arrays['candidate'].shape}: expected (T, ...), two frames or more")
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise UsageError(f"{name} has values that are not finite: expected frames of finite values")
    return tuple(np.diff(array, axis=0) for array in arrays.values())
