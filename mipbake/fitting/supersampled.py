"""References: what a renderer itself would show of the source, supersampled under the pixel filter."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.fitting.frames import with_cover
from mipbake.fitting.renderer import Array, Levels, Renderer
from mipbake.material.pixel_filter import PixelFilter
from mipbake.quality.reference.sequences import SEQUENCE


def supersampled(
    renderer: Renderer[Any],
    source: Levels,
    view: Any,
    kernel: PixelFilter,
    passes: int,
    seed: int = 0,
    whole: bool = True,
    size: tuple[int, int] | None = None,
) -> Array:
    """The mean of renders of a view whose sampling points are moved: the integral of section 3 of docs/conventions.md.

    Offsets are drawn from the pixel filter along a low-discrepancy sequence, with a random shift for each view.

    Args:
        source: level 0 of the source alone, so that no lookup is filtered by levels.
        view: has a method `moved(right, up)`, in pixels.
        passes: how many renders.
        whole: whether every pixel shows the maps and nothing else. Where not, only samples that show the maps count, so
            that what lies behind them leaves no trace at their edges.
        size: (height, width) that renders must have; None: as the first one.

    Returns:
        (H, W, 3) float32; 0 where no sample shows the maps.

    Raises:
        UsageError: a view that cannot be moved.
        RendererError: as `with_cover` raises it.
    """
    moved = getattr(view, "moved", None)
    if moved is None:
        raise UsageError(
            f"views of the type {type(view).__name__} have no method moved(right, up), which shifts what is rendered "
            "by parts of a pixel: expected it, or pass reference images"
        )
    who = f"the reference of {named(view)}"
    shift = np.random.default_rng([seed, _number(named(view))]).random(2)
    total: Any = 0.0
    counted: Any = 0.0
    for index in range(passes):
        offset, sign = kernel.offsets((shift + index * SEQUENCE) % 1.0)
        image, seen = with_cover(renderer.render(source, moved(float(offset[0]), float(offset[1]))), who, size)
        size = image.shape[0], image.shape[1]
        counting = float(np.prod(sign)) * (np.ones(size) if whole else seen)
        total = total + counting[..., None] * image.astype(np.float64)
        counted = counted + counting
    # The weights of a signed filter may cancel where few samples show the maps.
    return np.asarray(total / np.where(np.abs(counted) > _LEAST_WEIGHT, counted, np.inf)[..., None], np.float32)


_LEAST_WEIGHT = 1e-3  # of all samples of a pixel that count


def named(view: Any) -> str:
    """What messages call a view."""
    return str(getattr(view, "name", None) or f"a view ({type(view).__name__})")


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
