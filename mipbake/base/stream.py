"""The CUDA stream on which torch runs, for the torch ops of every door of the native core."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from mipbake.base.errors import UsageError

__all__ = ["current_stream", "errors_of_data"]


@contextmanager
def errors_of_data() -> Iterator[None]:
    """The native core's ValueError is about the numbers in an argument, and says so in a whole sentence."""
    try:
        yield
    except ValueError as error:
        raise UsageError(str(error)) from None


@contextmanager
def current_stream(tensor: Any, what: str) -> Iterator[int]:
    """Makes the tensor's device current and gives torch's stream on it as an integer; 0 on the CPU, and of arrays.

    Args:
        tensor: any argument of the op.
        what: its name in the op, for the error.

    Raises:
        UsageError: a CUDA tensor where the native core was built without CUDA.
    """
    if isinstance(tensor, np.ndarray) or tensor.device.type != "cuda":
        yield 0
        return
    import torch

    from mipbake import _native

    if not _native.cuda_compiled():
        raise UsageError(
            f"{what} is on {tensor.device}: expected the CPU, because this installation has no CUDA kernels; "
            "move it with .cpu(), or reinstall mipbake where CUDA's nvcc is found"
        )
    with torch.cuda.device(tensor.device):
        yield torch.cuda.current_stream(tensor.device).cuda_stream
