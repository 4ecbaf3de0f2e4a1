"""`linear`: average every stored channel and renormalise the normal.

With the box filter this is what GPUs and most tools do; with a pixel filter, level 0 is filtered too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake import directions, material
from mipbake.pixel_filter import Wrap
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.rules.bands import Array, closed_form_levels


class Linear:
    """Averages of the stored channels of the target model, under the pixel filter."""

    name = "linear"
    summary = "average of every stored channel (what GPUs do, with the pixel filter in place of the box)"
    averages = True
    own_memory = 0

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter."""
        read = None if source == target else lambda texels: material.convert(texels, source, target)

        def write(texels: Array) -> Array:
            return material.regularise(texels, target)

        levels = closed_form_levels(stored, read, write, pixel_filter, wrap, progress)
        return PrefilterResult(directions.agreeing(levels, target, wrap))
