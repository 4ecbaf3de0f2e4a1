"""What closed forms have in common: a method that is a form of every image."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mipbake.baking.prefilter import PrefilterResult
from mipbake.baking.rules.bands import Array, Image, texelwise
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.together import BLURRED, Together
from mipbake.base import memory
from mipbake.base.timings import Progress
from mipbake.material import MODELS, directions
from mipbake.material.pixel_filter import Wrap, level_sizes


class ClosedForm:
    """A method that is a Form of every image."""

    averages = True
    own_memory = 0

    def form(self, whole: Whole, target: str) -> Form:
        """The form of an image, for levels in a target model."""
        raise NotImplementedError

    def __call__(
        self, stored: Image, source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter."""
        whole = Whole(stored, source)
        levels = chain(whole, self.form(whole, target), MODELS[target].channels, pixel_filter, wrap, progress)
        return PrefilterResult(directions.agreeing(levels, target, wrap))


def chain(whole: Whole, form: Form, channels: int, kernel: str, wrap: Wrap, progress: Progress) -> list[Image]:
    """Every level of a complete chain, (H_L, W_L, channels), of one form.

    Args:
        kernel: a name in `mipbake.material.pixel_filter.FILTERS`. wrap: addressing along u and v.
        progress: takes the finished share, in this thread.
    """
    together = Together(whole, [(form, kernel)], wrap)
    (placed,) = together.placed
    levels = [memory.empty((*size, channels)) for size in level_sizes(*whole.stored.shape[:2])]

    def take(level: int, rows: slice, averages: Mapping[str, Image]) -> None:
        own = averages[kernel]
        count = own.shape[-1]
        both = np.concatenate([own, averages[BLURRED]], -1) if BLURRED in averages else own

        def write(texels: Array) -> Array:
            planes = np.moveaxis(texels, -1, 0)
            return placed.made({kernel: planes[:count], BLURRED: planes[count:]}, level)

        texelwise(write, both, levels[level][rows])

    together.show(take, progress)
    return levels
