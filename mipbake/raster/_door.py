"""Which of the two implementations takes an array."""

from __future__ import annotations

from types import ModuleType
from typing import Any


def door(array: Any) -> ModuleType:
    """The module whose functions take what `array` is: NumPy arrays, or torch tensors."""
    import numpy as np

    if isinstance(array, np.ndarray):
        from mipbake.raster import arrays

        return arrays
    from mipbake.raster import ops

    return ops
