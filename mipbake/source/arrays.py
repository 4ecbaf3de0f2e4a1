"""Arrays from Python as maps of a texture set: checked, because files store other numbers than these."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.errors import InputError
from mipbake.source.decode import RANGES, unit_vectors
from mipbake.source.options import COLOUR_ROLES


def checked_array(role: str, value: ArrayLike | float) -> NDArray[np.float32]:
    """(H, W, C) float32 of a role, vectors unit; InputError when the shape or a value does not fit the role."""
    channels = 3 if role in (*COLOUR_ROLES, "normal", "anisotropy") else 1
    array = np.array(value, np.float32)
    if array.ndim == 0 and role not in ("normal", "anisotropy", "emissive"):
        array = np.full((1, 1, channels), array, np.float32)
    elif array.ndim == 2 and (channels == 1 or role == "base_color"):
        array = array[..., None]
    if role == "base_color" and array.ndim == 3 and array.shape[2] == 1:
        array = np.repeat(array, 3, -1)
    if array.ndim != 3 or array.shape[2] != channels or 0 in array.shape:
        shape = "(H, W, 3)" if channels == 3 else "(H, W) or (H, W, 1)"
        raise InputError(f"{role} has shape {np.shape(value)}: expected {shape}, at least 1 x 1")
    if not np.isfinite(array).all():
        raise InputError(f"{role} holds {np.count_nonzero(~np.isfinite(array))} NaN or infinite values: expected none")
    _check_encoding(role, array, np.asarray(value).dtype)
    low, high = (0, 1) if role == "anisotropy" else RANGES.get(role, (-np.inf, np.inf))
    values = array[..., 2] if role == "anisotropy" else array
    if values.min() < low or values.max() > high:
        raise InputError(
            f"{role} runs from {values.min():g} to {values.max():g}: expected values from {low:g} to {high:g}"
        )
    if role == "normal" and array[..., 2].min() < 0:
        raise InputError("normal points into the surface: expected signed vectors with z at least 0")
    return np.ascontiguousarray(unit_vectors(array, role))


def _check_encoding(role: str, array: NDArray[np.float32], dtype: np.dtype[Any]) -> None:
    """InputError for values as files store them: integers that stand for 0 to 1, vectors moved into 0 to 1."""
    if role in ("normal", "anisotropy"):
        vectors = array if role == "normal" else array[..., :2]
        for top in (1, 255, 65535):  # the largest encoded value: of floats, of 8 bits and of 16 bits
            if vectors.min() >= 0 and vectors.max() <= top and _are_unit(2 * vectors / np.float32(top) - 1):
                if _are_unit(vectors):
                    return
                decoded = f"2 * values{'' if top == 1 else f' / {top}'} - 1"
                where = " for x and y" if role == "anisotropy" else ""
                raise InputError(
                    f"{role} is encoded in 0 to {top}, as files store it: expected signed vectors, "
                    f"pass {decoded}{where}"
                )
    elif role in RANGES and dtype.kind in "iu" and array.max() > 1:
        top = 255 if array.max() <= 255 else 65535
        decoded = f"values / {top}, decoded from sRGB" if role in COLOUR_ROLES else f"values / {top}"
        raise InputError(
            f"{role} holds integers up to {array.max():g}: expected {'linear ' if role in COLOUR_ROLES else ''}values "
            f"from 0 to 1, pass {decoded}"
        )


def _are_unit(vectors: NDArray[np.float32]) -> bool:
    """Whether vectors (H, W, C) have length one, except for rounding to 8 bits and a tenth of outliers."""
    off = np.abs(np.sqrt(np.einsum("hwc,hwc->hw", vectors, vectors)) - 1)
    return float(np.quantile(off, 0.9)) < 0.05


def check_shape(role: str, array: NDArray[np.float32], rows: int, columns: int) -> None:
    """InputError where a map that shades is not of one shape with the largest, of `rows` x `columns`."""
    h, w = array.shape[:2]
    if (h, w) != (1, 1) and (h > rows or w > columns or abs(w * rows - h * columns) > max(rows, columns)):
        raise InputError(f"{role} is {w} x {h} and the largest map is {columns} x {rows}: expected one shape")
