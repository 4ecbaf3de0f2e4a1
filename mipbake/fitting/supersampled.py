"""References: what a renderer itself would show of the source, supersampled under the pixel filter."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

from mipbake.errors import UsageError
from mipbake.fitting.frames import rendered
from mipbake.fitting.renderer import Array, Levels, Renderer
from mipbake.pixel_filter import PixelFilter
from mipbake.reference.sequences import SEQUENCE


def supersampled(
    renderer: Renderer[Any],
    source: Levels,
    view: Any,
    kernel: PixelFilter,
    passes: int,
    seed: int = 0,
    heard: Callable[[float], None] = lambda _share: None,
) -> Array:
    """The mean of renders of a view whose sampling points are moved: the integral of section 3 of docs/conventions.md.

    Offsets are drawn from the pixel filter along a low-discrepancy sequence, with a random shift for each view.

    Args:
        source: level 0 of the source alone, so that no lookup is filtered by levels.
        view: has a method `moved(right, up)`, in pixels.
        passes: how many renders.
        heard: told the share that is done.

    Returns:
        (H, W, 3) float32.

    Raises:
        UsageError: a view that cannot be moved.
        RendererError: as `rendered` raises it.
    """
    moved = getattr(view, "moved", None)
    if moved is None:
        raise UsageError(
            f"views of the type {type(view).__name__} have no method moved(right, up), which shifts what is rendered "
            "by parts of a pixel: expected it, or pass reference images"
        )
    who = f"the reference of {named(view)}"
    shift = np.random.default_rng([seed, _number(named(view))]).random(2)
    total, weights, size = None, 0.0, None
    for index in range(passes):
        offset, sign = kernel.offsets((shift + index * SEQUENCE) % 1.0)
        image = rendered(renderer, source, moved(float(offset[0]), float(offset[1])), who, size)
        weight = float(np.prod(sign))
        total = weight * image.astype(np.float64) if total is None else total + weight * image
        weights, size = weights + weight, (image.shape[0], image.shape[1])
        heard((index + 1) / passes)
    assert total is not None
    return np.asarray(total / weights, np.float32)


def named(view: Any) -> str:
    """What messages call a view."""
    return str(getattr(view, "name", None) or f"a view ({type(view).__name__})")


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
