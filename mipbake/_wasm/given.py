"""What callers give: arrays as they should be, and names as numbers of the core. ValueError where they differ."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mipbake._wasm.machine import Out


def checked(name: str, value: Any, kind: DTypeLike, shape: tuple[int, ...]) -> Any:
    """An array or a tensor as an array, if it is what it should be; None for None."""
    if value is None:
        return None
    array = np.asarray(value)
    if array.dtype != kind or array.shape != shape:
        raise ValueError(f"unexpected shape or dtype of {name}")
    return array


def filled(name: str, value: Any, kind: DTypeLike, shape: tuple[int, ...]) -> Out | None:
    """The same for an array that a call fills."""
    array = checked(name, value, kind, shape)
    return None if array is None else Out(array)


def indices(name: str, value: Any, kind: DTypeLike, shape: tuple[int, ...], size: int) -> NDArray[Any]:
    """The same for indices below a size."""
    array: NDArray[Any] = checked(name, value, kind, shape)
    if array.size and not 0 <= array.min() <= array.max() < size:
        raise ValueError("an index is out of range")
    return array


def real_dtype(value: Any) -> np.dtype[Any]:
    """The dtype of an array of real numbers."""
    kind = np.asarray(value).dtype
    if kind not in (np.float32, np.float64):
        raise ValueError("expected float32 or float64")
    return kind


def number_of(what: str, name: str, names: list[str]) -> int:
    """The place of a name among others."""
    if name not in names:
        raise ValueError(f"no such {what}: {name}")
    return names.index(name)
