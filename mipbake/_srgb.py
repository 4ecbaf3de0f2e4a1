"""The transfer function of sRGB, IEC 61966-2-1, and its inverse: files and displays use one definition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def srgb_to_linear(encoded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Decoding, (...) to (...), dtype kept; odd around zero, so that values outside [0, 1] survive."""
    size = np.abs(encoded)
    decoded = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.copysign(decoded, encoded), encoded.dtype)


def linear_to_srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Encoding, (...) to (...): the inverse of `srgb_to_linear` from 0 up; nothing is clipped."""
    powered = 1.055 * np.power(np.maximum(linear, 0.0031308), 1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, powered)
