"""Signal-to-noise ratio against a Monte Carlo reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_SNR_DB = 100.0
"""Largest value reported: float32 shading resolves no more, and an error of exactly zero has no logarithm."""

_RESOLVED = 0.01  # share of the reference's noise energy; sums over 10^5 values and more average the rest away


def snr_db(candidate: NDArray[np.float32], first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """10 log10(sum R^2 / sum (P - R)^2) in dB, all arrays of one shape, linear light.

    R is known through two independent unbiased estimates. Their products estimate both sums without the bias that
    the noise of one estimate would put into its square: E[(P - R1)(P - R2)] = (P - R)^2. An error below a hundredth of
    the reference's own noise is not resolved: it is taken as that hundredth, so that chance reports no perfection. The
    result is at most MAX_SNR_DB, and nan where the signal is zero everywhere.
    """
    p, r1, r2 = (np.asarray(a, np.float64) for a in (candidate, first, second))
    signal = float((r1 * r2).sum())
    noise = float(np.square(r1 - r2).sum()) / 2
    error = max(float(((p - r1) * (p - r2)).sum()), _RESOLVED * noise)
    if signal <= 0:
        return float("nan")
    if error <= signal * 10 ** (-MAX_SNR_DB / 10):
        return MAX_SNR_DB
    return 10 * float(np.log10(signal / error))
