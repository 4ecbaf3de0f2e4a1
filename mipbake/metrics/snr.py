"""Signal-to-noise ratio against a Monte Carlo reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_SNR_DB = 100.0
"""Largest value reported: float32 shading resolves no more, and an error of exactly zero has no logarithm."""


def snr_db(candidate: NDArray[np.float32], first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """10 log10(sum R^2 / sum (P - R)^2) in dB, all arrays of one shape, linear light.

    R is known through two independent unbiased estimates. Their products estimate both sums without the bias that
    the noise of one estimate would put into its square: E[(P - R1)(P - R2)] = (P - R)^2. Where the error vanishes in
    the noise that leaves, the result is MAX_SNR_DB; where the signal is zero everywhere it is nan.
    """
    p, r1, r2 = (np.asarray(a, np.float64) for a in (candidate, first, second))
    signal = float((r1 * r2).sum())
    error = float(((p - r1) * (p - r2)).sum())
    if signal <= 0:
        return float("nan")
    if error <= signal * 10 ** (-MAX_SNR_DB / 10):
        return MAX_SNR_DB
    return 10 * float(np.log10(signal / error))
