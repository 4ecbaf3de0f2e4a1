"""File values to the numbers that texels hold: integers, correctly rounded, and floating-point numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError

KINDS = {"8": np.uint8, "16": np.uint16, "half": np.float16, "float": np.float32}
"""What a texel's channel is stored as, by the name that users give."""

_MOST = {"8": 255, "16": 65535, "half": float(np.finfo(np.float16).max), "float": float(np.finfo(np.float32).max)}


def quantised(values: NDArray[np.float64], kind: str, what: str) -> NDArray[np.generic]:
    """(..., C) file values to texels of a kind in `KINDS`, correctly rounded; UsageError for a value beyond what the
    kind stores. `what` holds them, for sentences: "the map roughness"."""
    most = _MOST[kind]
    if kind in ("half", "float"):
        largest = float(max(values.max(), -values.min()))
        if not largest <= most:
            raise UsageError(
                f"{what} holds the value {largest:g}, beyond what a {kind} file stores ({most:g}): scale the source "
                "map down"
            )
        return values.astype(KINDS[kind])
    check_fits(values, kind, what)
    return np.floor(np.clip(values, 0, 1) * most + 0.5).astype(KINDS[kind])


def dequantised(texels: NDArray[np.generic]) -> NDArray[np.floating]:
    """Inverse of quantised, to file values."""
    if texels.dtype.kind == "f":
        return texels.astype(np.float32)
    return texels.astype(np.float64) / (255.0 if texels.dtype == np.uint8 else 65535.0)


def check_fits(values: NDArray[np.float64], kind: str, what: str) -> None:
    """UsageError for a value outside 0 to 1, where integers of a kind are to hold it; see `quantised`."""
    most = _MOST[kind]
    if not fits(values, most):
        low, high = float(values.min()), float(values.max())
        outside = low if low < -0.5 / most else high
        raise UsageError(
            f"texels of {kind} bits cannot hold {what}: it has the value {outside:g}, outside 0 to 1, use format exr"
        )


def fits(values: NDArray[np.float64], most: float = 255) -> bool:
    """Whether values lie in 0 to 1, up to what rounding to `most` steps costs anyway."""
    return bool(values.min() >= -0.5 / most and values.max() <= 1 + 0.5 / most)
