"""Signal-to-noise ratio against a Monte Carlo reference."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.images import ImageArray, check_same_shape

MAX_SNR_DB = 100.0
"""Largest value reported: float32 shading resolves no more, and an error of exactly zero has no logarithm. Not
tuned."""

# Share of the reference's noise energy. Sums over 10^5 values and more average the rest away.
_RESOLVED = 0.01


def snr_db(candidate: ImageArray, first: ImageArray, second: ImageArray) -> float:
    """10 log10(sum R^2 / sum (P - R)^2) in dB, all arrays of one shape, linear light.

    R is known through two independent unbiased estimates. Their products estimate both sums without the bias that
    the noise of one estimate would put into its square: E[(P - R1)(P - R2)] = (P - R)^2. An error below a hundredth of
    the reference's own noise is not resolved: it is taken as that hundredth, so that chance reports no perfection. The
    result is at most MAX_SNR_DB, and nan where the signal is zero everywhere or a value is nan.
    """
    return float(snr_from_sums(_sums(1, candidate, first, second)[0]))


def snr_sums(candidate: ImageArray, first: ImageArray, second: ImageArray) -> NDArray[np.float64]:
    """The sums that snr_db compares, one row (signal, error, noise) an entry of the first axis: (K, ...) to (K, 3).

    Rows add up, so that light-view pairs can be resampled (mipbake.quality.metrics.intervals): snr_db of the whole is
    snr_from_sums(snr_sums(...).sum(0)).
    """
    return _sums(len(candidate), candidate, first, second)


def snr_from_sums(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) sums, or sums of rows of them, to (...) SNR in dB; caps and nan as snr_db has them."""
    signal, error, noise = np.moveaxis(np.asarray(sums, np.float64), -1, 0)
    lit = signal > 0
    ratio = np.maximum(error, _RESOLVED * noise) / np.where(lit, signal, 1)
    capped = -10 * np.log10(np.maximum(ratio, 10 ** (-MAX_SNR_DB / 10)))
    return np.where(lit, capped, math.nan)


def _sums(rows: int, candidate: ImageArray, first: ImageArray, second: ImageArray) -> NDArray[np.float64]:
    p, r1, r2 = (np.asarray(a, np.float64) for a in (candidate, first, second))
    check_same_shape(first=r1, second=r2, candidate=p)
    p, r1, r2 = (a.reshape(rows, -1) for a in (p, r1, r2))
    return np.stack([(r1 * r2).sum(-1), ((p - r1) * (p - r2)).sum(-1), np.square(r1 - r2).sum(-1) / 2], -1)
