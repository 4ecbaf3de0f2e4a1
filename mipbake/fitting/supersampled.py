"""References: what a renderer itself would show of the source, supersampled under the pixel filter."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import UsageError
from mipbake.fitting.frames import rendered, with_cover
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
    whole: bool = True,
    heard: Callable[[float], None] = lambda _share: None,
) -> Array:
    """The mean of renders of a view whose sampling points are moved: the integral of section 3 of docs/conventions.md.

    Offsets are drawn from the pixel filter along a low-discrepancy sequence, with a random shift for each view.

    Args:
        source: level 0 of the source alone, so that no lookup is filtered by levels.
        view: has a method `moved(right, up)`, in pixels.
        passes: how many renders.
        whole: whether every pixel shows the maps and nothing else. Where not, only samples that show the maps count, so
            that what lies behind them leaves no trace at their edges.
        heard: told the share that is done.

    Returns:
        (H, W, 3) float32; 0 where no sample shows the maps.

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
    total: NDArray[np.float64] | None = None
    weights: Any = 0.0
    for index in range(passes):
        offset, sign = kernel.offsets((shift + index * SEQUENCE) % 1.0)
        place = moved(float(offset[0]), float(offset[1]))
        size = None if total is None else (total.shape[0], total.shape[1])
        if whole:
            image = rendered(renderer, source, place, who, size)
            weight: Any = float(np.prod(sign))
        else:
            image, seen = with_cover(renderer.render(source, place), who, size)
            weight = float(np.prod(sign)) * seen[..., None]
        total = weight * image.astype(np.float64) + (0 if total is None else total)
        weights = weights + weight
        heard((index + 1) / passes)
    assert total is not None
    # The weights of a signed filter may cancel where few samples show the maps.
    return np.asarray(total / np.where(np.abs(weights) > _LEAST_WEIGHT, weights, np.inf), np.float32)


_LEAST_WEIGHT = 1e-3  # of all samples of a pixel that count; a guess


def named(view: Any) -> str:
    """What messages call a view."""
    return str(getattr(view, "name", None) or f"a view ({type(view).__name__})")


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
