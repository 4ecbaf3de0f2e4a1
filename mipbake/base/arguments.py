"""Arguments of the doors to the native core, NumPy arrays or torch tensors, checked in one way and in the same words.

Every check raises `UsageError` with a sentence that names the argument, what it is and what was expected.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from mipbake.base.aligned import check_dense, dense
from mipbake.base.errors import UsageError

REAL = ("float32", "float64")
"""Dtypes that most kernels have."""

Sizes = Sequence[int | str]
"""A shape: sizes, and names of sizes that may be any."""


def is_array(value: Any) -> bool:
    """Whether it is a NumPy array."""
    return isinstance(value, np.ndarray)


def dtype_of(value: Any) -> str:
    """The dtype's name, such as "float32"."""
    return _name(value.dtype)


@cache
def _name(dtype: Any) -> str:
    """NumPy takes longer to name a dtype than a kernel takes for hundreds of elements."""
    return str(dtype).removeprefix("torch.")


def device_of(value: Any) -> str:
    """The device's name; "cpu" for NumPy arrays."""
    return "cpu" if is_array(value) else str(value.device)


def check_kind(name: str, value: Any, like: tuple[str, Any] | None = None) -> None:
    """A dense array or tensor: of the kind of another argument, given by name and value, or of either kind."""
    tensor = hasattr(value, "requires_grad")
    if like is None and not (tensor or is_array(value)):
        raise UsageError(f"{name} is a {type(value).__name__}: expected a NumPy array or a torch tensor")
    if like is not None and not (is_array(value) if is_array(like[1]) else tensor):
        wanted = "NumPy array" if is_array(like[1]) else "torch tensor"
        raise UsageError(f"{name} is a {type(value).__name__}: expected a {wanted}, as {like[0]} is")
    if tensor:
        check_dense(name, value)
        if value.device.type not in ("cpu", "cuda", "meta"):
            raise UsageError(f"{name} is on {value.device}: expected the CPU or CUDA")


def checked(
    name: str,
    value: Any,
    like: tuple[str, Any] | None = None,
    dtypes: Sequence[str] = (),
    shapes: Iterable[Sizes] = (),
    meaning: str = "",
) -> Any:
    """The value, where it is a dense array or tensor that fits.

    Args:
        like: name and value of another argument, whose kind and device it must have.
        dtypes: names of those that it may have; none for any.
        shapes: those that it may have; none for any.
        meaning: what a shape holds, for the sentence.
    """
    check_kind(name, value, like)
    if like is not None and device_of(value) != device_of(like[1]):
        raise UsageError(f"{name} is on {device_of(value)}: expected {device_of(like[1])}, where {like[0]} is")
    if dtypes and dtype_of(value) not in dtypes:
        *others, last = dtypes
        either = f"{', '.join(others)} or {last}" if others else last
        reason = f", as {like[0]} is" if like is not None and not others and dtype_of(like[1]) == last else ""
        raise UsageError(f"{name} is {dtype_of(value)}: expected {either}{reason}")
    if dtypes and dtype_of(value) == "float64" and device_of(value).startswith("cuda"):
        raise UsageError(f"{name} is float64 on {value.device}: expected float32, or the CPU")
    if shapes:
        check_shape(name, value.shape, shapes, meaning)
    return value


def check_shape(name: str, shape: Sequence[int], shapes: Iterable[Sizes], meaning: str = "") -> None:
    """The shape is one of `shapes`."""
    for sizes in shapes:
        if len(sizes) == len(shape) and all(isinstance(w, str) or w == s for w, s in zip(sizes, shape, strict=True)):
            return
    listed = " or ".join(str(tuple(sizes)).replace("'", "") for sizes in shapes)
    raise UsageError(f"{name} has shape {tuple(shape)}: expected {listed}{meaning and ', ' + meaning}")


def reals(name: str, value: Any, like: tuple[str, Any], dtype: str) -> Any:
    """Real numbers in a dtype: beside a tensor a tensor on its device, beside an array whatever NumPy takes for one."""
    if not is_array(like[1]):
        checked(name, value, like)
        if value.is_complex() or dtype_of(value) == "bool":
            raise UsageError(f"{name} is {dtype_of(value)}: expected real numbers")
        return value.double() if dtype == "float64" else value.float()
    if hasattr(value, "requires_grad"):
        raise UsageError(f"{name} is a {type(value).__name__}: expected a NumPy array, as {like[0]} is")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:  # sequences of different lengths
        raise UsageError(f"{name} is not an array of numbers ({str(error).partition(chr(10))[0][:120]})") from None
    if array.dtype.kind not in "fiu":
        raise UsageError(f"{name} is {array.dtype}: expected real numbers")
    with np.errstate(over="ignore"):  # what lies beyond float32 becomes infinite
        return array.astype(dtype, copy=False)


def batch_size(sizes: Mapping[str, int]) -> int:
    """The one batch size of some arguments, by name; those of 1 repeat."""
    batch = next((size for size in sizes.values() if size != 1), 1)
    if any(size not in (1, batch) for size in sizes.values()):
        listed = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise UsageError(f"batch sizes do not fit: {listed}; expected each to be 1 or the same number")
    return batch


def writable(name: str, value: Any, *fits: Any) -> Any:
    """`checked`, of what is changed in place: contiguous, aligned, and no copy of something else."""
    checked(name, value, *fits)
    found = dense(value)
    if not (found is value and value.flags.writeable if is_array(value) else found.data_ptr() == value.data_ptr()):
        raise UsageError(
            f"{name} is not contiguous, or cannot be written to: expected an array that is changed in place"
        )
    return found


def empty(like: Any, shape: Sequence[int], dtype: str | None = None) -> Any:
    """A new array of the kind, on the device and, unless another is named, in the dtype of another."""
    if is_array(like):
        return np.empty(shape, dtype or like.dtype)
    import torch

    return like.new_empty(tuple(shape), dtype=getattr(torch, dtype) if dtype else None)


def whole(value: Any) -> int | None:
    """A whole number of any kind as an int; None where it is none."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None
