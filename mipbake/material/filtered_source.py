"""What a reference filters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.material.pixel_filter import Wrap


@dataclass(frozen=True, eq=False)
class FilteredSource:
    """Level 0 of a source and the pixel filter that it is seen under.

    Args:
        stored: (H, W, C) stored channels, interpolated bilinearly before anything else happens to them.
        model: the material model of the channels. wrap: addressing along u and v.
        pixel_filter: a name in `mipbake.material.pixel_filter.FILTERS`.
    """

    stored: NDArray[np.float32]
    model: str
    wrap: Wrap
    pixel_filter: str

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels."""
        return self.stored.shape[0], self.stored.shape[1]
