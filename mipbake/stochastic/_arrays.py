"""NumPy arrays and torch tensors alike: checks with sentences, new arrays of the same kind, the stream they are on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from mipbake.base.aligned import aligned, check_dense, contiguous
from mipbake.base.errors import UsageError
from mipbake.base.stream import current_stream

REAL = ("float32", "float64")


def is_array(value: Any) -> bool:
    """Whether it is a NumPy array."""
    return isinstance(value, np.ndarray)


def dtype_of(value: Any) -> str:
    """The dtype's name, such as "float32"."""
    return str(value.dtype).removeprefix("torch.")


def device_of(value: Any) -> str:
    """The device's name; "cpu" for NumPy arrays."""
    return "cpu" if is_array(value) else str(value.device)


def given(name: str, value: Any, dtypes: Sequence[str], shape: Sequence[int | None], like: Any = None) -> Any:
    """The value as native code reads it: contiguous, aligned, without a gradient.

    Args:
        dtypes: names of those that it may have.
        shape: sizes; None for any.
        like: another argument, whose kind and device it must have.

    Raises:
        UsageError: something else.
    """
    kind = type(value).__name__
    if not (is_array(value) or (kind in ("Tensor", "Parameter") and hasattr(value, "detach"))):
        raise UsageError(f"{name} is a {kind}: expected a NumPy array or a torch tensor")
    if not is_array(value):
        check_dense(name, value)
        if value.device.type not in ("cpu", "cuda"):
            raise UsageError(f"{name} is on {value.device}: expected the CPU or CUDA")
    if like is not None and (is_array(value) != is_array(like) or device_of(value) != device_of(like)):
        raise UsageError(
            f"{name} is a {kind} on {device_of(value)}: expected a {type(like).__name__} on {device_of(like)}, as the "
            "other arguments are"
        )
    sizes = tuple(value.shape)
    fits = len(sizes) == len(shape) and all(w is None or w == s for s, w in zip(sizes, shape, strict=False))
    if not fits:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise UsageError(f"{name} has shape {sizes}: expected ({wanted}), 'any' being any size")
    if dtype_of(value) not in dtypes:
        raise UsageError(f"{name} is {dtype_of(value)}: expected {' or '.join(dtypes)}")
    if device_of(value).startswith("cuda") and "float64" in dtypes and dtype_of(value) == "float64":
        raise UsageError(f"{name} is float64 on {device_of(value)}: expected float32, or the CPU")
    if is_array(value):
        return contiguous(value)
    return aligned(value.detach().contiguous())


def writable(name: str, value: Any, dtypes: Sequence[str], shape: Sequence[int | None], like: Any = None) -> Any:
    """As `given`, of an array that is written to: a copy would lose what is written."""
    found = given(name, value, dtypes, shape, like)
    same = found is value and value.flags.writeable if is_array(value) else found.data_ptr() == value.data_ptr()
    if not same:
        raise UsageError(
            f"{name} is not contiguous, or cannot be written to: expected an array that is changed in place"
        )
    return found


def empty(like: Any, shape: Sequence[int], dtype: str) -> Any:
    """A new array of the kind and on the device of another."""
    if is_array(like):
        return np.empty(shape, dtype)
    import torch

    return torch.empty(tuple(shape), dtype=getattr(torch, dtype), device=like.device)


def zeros(like: Any, shape: Sequence[int], dtype: str) -> Any:
    """The same, of zeros."""
    made = empty(like, shape, dtype)
    made[...] = 0
    return made


@contextmanager
def stream_of(value: Any, what: str) -> Iterator[int]:
    """The stream of CUDA that torch works on, as a number; 0 on the CPU."""
    if is_array(value):
        yield 0
    else:
        with current_stream(value, what) as stream:
            yield stream
