"""Arrays as the native core can read them: elements at addresses that are multiples of their size.

NumPy and torch read what a file or a network packet holds at any address; on some processors native code cannot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mipbake.base.errors import UsageError

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["aligned", "check_dense", "contiguous", "dense", "strided"]


def contiguous(array: Any, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """The array itself where it is C-contiguous, aligned and of that dtype (None: any), else a copy that is."""
    return np.require(array, dtype, ["C", "A"])


def aligned(tensor: Tensor) -> Tensor:
    """The tensor itself where its elements are aligned and as they lie in memory, else a copy.

    torch may leave a sign to be changed by whoever reads (`tensor.is_neg()`), which native code does not.
    """
    tensor = tensor.resolve_neg()
    return tensor.clone() if tensor.data_ptr() % tensor.element_size() else tensor


def dense(value: Any) -> Any:
    """An array or a tensor as the native core reads it: contiguous, aligned, and no part of a graph."""
    return contiguous(value) if isinstance(value, np.ndarray) else aligned(value.detach().contiguous())


def strided(value: Any) -> Any:
    """The same where the native core reads any strides: a copy only where elements lie off multiples of their size."""
    if isinstance(value, np.ndarray):
        whole = all(stride % value.itemsize == 0 for stride in value.strides)
        return value if whole and value.flags.aligned else contiguous(value)
    return aligned(value.detach())


def check_dense(name: str, tensor: Tensor) -> None:
    """UsageError unless a tensor is one block of numbers, as the native core reads it: not nested, sparse or quantised.

    For before its shape is looked at, which nested tensors do not have.
    """
    if tensor.is_nested:
        raise UsageError(f"{name} is a nested tensor: expected a dense tensor, such as {name}.to_padded_tensor(0)")
    if str(tensor.layout) != "torch.strided":
        raise UsageError(f"{name} is {tensor.layout}: expected a dense tensor, such as {name}.to_dense()")
    if tensor.is_quantized:
        raise UsageError(f"{name} is {tensor.dtype}: expected real numbers, such as {name}.dequantize()")
