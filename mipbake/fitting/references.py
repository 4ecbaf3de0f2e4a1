"""References: images that are given, or what a renderer itself shows of the source, supersampled."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.fitting.frames import cover_of, image_of, named
from mipbake.fitting.renderer import Array, Levels, Renderer
from mipbake.material.pixel_filter import PixelFilter
from mipbake.quality.reference.sequences import SEQUENCE

_LEAST_WEIGHT = 1e-3  # of all samples of a pixel that count


class Supersampled:
    """What a renderer shows of a view whose sampling points are moved, as docs/conventions.md defines it.

    It is estimated twice, by two *halves* that know nothing of each other, so that their difference says how much noise
    their mean has. Offsets of each half are drawn from the pixel filter along a low-discrepancy sequence, with a random
    shift for each view and half. So a reference begins with few renders, and is refined by more.

    Args:
        source: level 0 of the source alone, so that no lookup is filtered by levels.
        view: has a method `moved(right, up)`, in pixels.
        whole: whether every pixel shows the maps and nothing else. Where not, only samples that show the maps count, so
            that what lies behind them leaves no trace at their edges.
        size: (height, width) that renders must have; None: as the first one.

    Raises:
        UsageError: a view that cannot be moved.
    """

    def __init__(
        self,
        renderer: Renderer[Any],
        source: Levels,
        view: Any,
        kernel: PixelFilter,
        seed: int = 0,
        whole: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        if getattr(view, "moved", None) is None:
            raise UsageError(
                f"views of the type {type(view).__name__} have no method moved(right, up), which shifts what is "
                "rendered by parts of a pixel: expected it, or pass reference images"
            )
        self._renderer, self._source, self._view, self._kernel = renderer, source, view, kernel
        self._whole, self._size = whole, size
        of_name = int.from_bytes(hashlib.sha256(named(view).encode()).digest()[:8], "little")
        self._shifts = np.random.default_rng([seed, of_name]).random((2, 2))
        self._totals: list[Any] = [0.0, 0.0]
        self._counted: list[Any] = [0.0, 0.0]
        self.passes = 0

    def refine(self, passes: int) -> None:
        """Renders until there are so many renders in all, half of them for each half."""
        who = f"the reference of {named(self._view)}"
        for index in range(self.passes, passes):
            half, at = index % 2, index // 2
            offset, sign = self._kernel.offsets((self._shifts[half] + at * SEQUENCE) % 1.0)
            frame = self._renderer.render(self._source, self._view.moved(float(offset[0]), float(offset[1])))
            image = image_of(frame, who, self._size)
            self._size = image.shape[0], image.shape[1]
            seen = cover_of(frame, self._size, who)
            counting = float(np.prod(sign)) * (np.ones(self._size) if self._whole else seen)
            self._totals[half] = self._totals[half] + counting[..., None] * image.astype(np.float64)
            self._counted[half] = self._counted[half] + counting
            self.passes = index + 1

    def halves(self) -> Array:
        """(2, H, W, 3) float32, both estimates, of two passes or more. Where no sample of a half shows the maps, it is
        the other half; where none of both does, 0."""
        totals, counted = np.stack(self._totals), np.stack(self._counted)[..., None]
        counted = np.where(np.abs(counted) > _LEAST_WEIGHT, counted, np.inf)  # weights of a signed filter may cancel
        means = totals / counted
        return np.asarray(np.where(np.isinf(counted), means[::-1], means), np.float32)


def given(value: Any, who: str, size: tuple[int, int]) -> Array:
    """A copy (H, W, 3) of an image that is given, because whoever made it may use the array again. UsageError: it has
    another shape, or is not finite."""
    image = np.asarray(value, np.float32)
    if image.ndim != 3 or image.shape[:2] != size or image.shape[2] not in (3, 4) or not np.isfinite(image).all():
        raise UsageError(
            f"the reference of {who} has shape {image.shape}: expected ({size[0]}, {size[1]}, 3) finite numbers, as "
            "the renderer's image has"
        )
    return np.array(image[..., :3], order="C")
