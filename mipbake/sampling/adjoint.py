"""The adjoint of bilinear lookups on NumPy arrays, without torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.base.aligned import contiguous

__all__ = ["scatter_linear"]

_Floats = NDArray[np.float32]


def scatter_linear(size: tuple[int, int], uv: _Floats, values: _Floats, boundary: tuple[str, str]) -> _Floats:
    """What lookups of one level pass back to its texels: the gradient of the sum of `values * lookup` by the level.

    Lookups are made as by `mipbake.sampling.texture` with the filter "linear". Sums run in the order of the lookups:
    the same bits whatever the number of threads.

    Args:
        size: (height, width) of the level.
        uv: (P, 2) texture coordinates, float32.
        values: (P, C) float32.
        boundary: modes along u and v, "wrap", "clamp", "mirror" or "zero".

    Returns:
        (height, width, C), float32.
    """
    from mipbake import _native

    channels = values.shape[-1]
    out = np.zeros((1, *size, channels), np.float32)
    if len(values):
        # The texels themselves play no part: one stands for all.
        level = np.broadcast_to(np.zeros(channels, np.float32), out.shape)
        rows = contiguous(values)[None], [level], contiguous(uv)[None]
        _native.texture_backward(*rows, None, None, "linear", *boundary, [out], None, None, None)
    return np.asarray(out[0])
