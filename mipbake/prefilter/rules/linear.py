"""`linear`: average every stored channel and renormalise the normal.

With the box filter this is what GPUs and most tools do; with a pixel filter, level 0 is filtered too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake import directions, material
from mipbake.pixel_filter import Wrap, filtered_levels
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.rules.averages import by_rows


class Linear:
    """Averages of the stored channels of the target model, under the pixel filter."""

    name = "linear"
    summary = "average of every stored channel (what GPUs do, with the pixel filter in place of the box)"
    averages = True

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter."""
        channels = by_rows(lambda texels: material.convert(texels, source, target), stored)
        levels = filtered_levels(channels, pixel_filter, wrap, progress)
        del channels
        for index, level in enumerate(levels):
            levels[index] = by_rows(lambda texels: material.regularise(texels, target), level)
        return PrefilterResult(directions.agreeing(levels, target, wrap))
