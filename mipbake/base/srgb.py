"""The transfer function of sRGB, IEC 61966-2-1, and its inverse: files and displays use one definition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_JOINT, _SLOPE = 0.0031308, 12.92  # up to which linear value the encoding is a straight line, and its slope
_SCALE, _OFFSET, _POWER = 1.055, 0.055, 2.4


def srgb_to_linear(encoded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Decoding, (...) to (...), dtype kept; odd around zero, so that values outside [0, 1] survive."""
    size = np.abs(encoded)
    decoded = np.where(size <= 0.04045, size / _SLOPE, ((size + _OFFSET) / _SCALE) ** _POWER)
    return np.asarray(np.copysign(decoded, encoded), encoded.dtype)


def linear_to_srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Encoding, (...) to (...): the inverse of `srgb_to_linear` from 0 up; nothing is clipped."""
    powered = _SCALE * np.power(np.maximum(linear, _JOINT), 1 / _POWER) - _OFFSET
    return np.where(linear <= _JOINT, _SLOPE * linear, powered)


def slope_of_decoding(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Derivative of `srgb_to_linear` where it gives these values (...), from 0 to 1; dtype kept."""
    powered = _POWER / _SCALE * np.maximum(linear, _JOINT) ** (1 - 1 / _POWER)
    return np.asarray(np.where(linear <= _JOINT, 1 / _SLOPE, powered), linear.dtype)
