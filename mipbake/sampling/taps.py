"""Which texels bilinear lookups read, and what they make of them: for images of which only these texels are known.

The bits are the same as of `mipbake.sampling.texture` with `filter_mode="linear"`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.base.aligned import contiguous

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LinearTaps:
    """Where P bilinear lookups lie.

    Args:
        texels: (P, 4) which texels each lookup reads, by their places: two of a row, and two of the row below.
        fractions: (P, 2) the way from the first to the second along a row, and from row to row.
    """

    texels: NDArray[np.int64]
    fractions: Floats

    def mixed(self, values: Floats) -> Floats:
        """(P, C) what the lookups give, of (N, C) texels in the order of the places."""
        from mipbake import _native

        out = np.empty((len(self.texels), values.shape[1]), np.float32)
        if out.size:
            _native.texture_quads(contiguous(values), self.texels, self.fractions, out)
        return out


def linear_taps(size: tuple[int, int], uv: NDArray[np.floating], boundary: tuple[str, str]) -> LinearTaps:
    """Where (P, 2) uv lie in an image of a size (height, width), whose texels are counted row by row.

    Args:
        boundary: modes along u and v, "wrap", "clamp" or "mirror".
    """
    from mipbake import _native

    texels, fractions = np.empty((len(uv), 4), np.int64), np.empty((len(uv), 2), np.float32)
    if len(uv):
        _native.texture_taps(*size, contiguous(uv, np.dtype(np.float32)), *boundary, texels, fractions)
    return LinearTaps(texels, fractions)
