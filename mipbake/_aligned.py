"""Arrays as the native core can read them: elements at addresses that are multiples of their size.

NumPy and torch read what a file or a network packet holds at any address; on some processors native code cannot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["aligned", "contiguous"]


def contiguous(array: Any, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """The array itself where it is C-contiguous, aligned and of that dtype (None: any), else a copy that is."""
    return np.require(array, dtype, ["C", "A"])


def aligned(tensor: Tensor) -> Tensor:
    """The tensor itself where its elements are aligned, else a copy."""
    return tensor.clone() if tensor.data_ptr() % tensor.element_size() else tensor
