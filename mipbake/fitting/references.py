"""References: images that are given, or what a renderer itself shows of the source, supersampled."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.fitting.frames import Looked, cover_of, image_of
from mipbake.fitting.renderer import Array, Levels, Renderer
from mipbake.material.pixel_filter import PixelFilter
from mipbake.quality.reference.sequences import SEQUENCE

_LEAST_WEIGHT = 1e-3  # of all samples of a pixel that count
_LEAST_PASSES, _MOST_PASSES, _CHECKED = 16, 256, 4
"""Renders of a reference: so many at level of detail 0, twice as many at each level more, up to so many; and so many
times as many where a view is held out. Noise in what is learned from averages out over the views (Lehtinen et al.
2018), so more views are better than less noise."""


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
        RendererError: a frame that is none.
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
        frame = renderer.render(source, moved(float(offset[0]), float(offset[1])))
        image = image_of(frame, who, size)
        size = image.shape[0], image.shape[1]
        seen = cover_of(frame, size, who)
        counting = float(np.prod(sign)) * (np.ones(size) if whole else seen)
        total = total + counting[..., None] * image.astype(np.float64)
        counted = counted + counting
    # The weights of a signed filter may cancel where few samples show the maps.
    return np.asarray(total / np.where(np.abs(counted) > _LEAST_WEIGHT, counted, np.inf)[..., None], np.float32)


def passes_for(lod: float, held_out: bool) -> int:
    """Renders of a reference whose pixels see 4^lod texels."""
    passes = int(np.clip(_LEAST_PASSES * 2.0 ** max(lod, 0.0), _LEAST_PASSES, _MOST_PASSES))
    return passes * _CHECKED if held_out else passes


def middle_lod(found: Looked, size: tuple[int, int]) -> float:
    """The level of detail in the middle of those of a view, for maps that measure (height, width)."""
    seen = found.seen > 0
    if found.lod is not None:
        return float(np.median(found.lod[seen]))
    assert found.uv_da is not None
    scaled = found.uv_da[seen].reshape(-1, 2, 2) * np.array([[size[1]], [size[0]]], np.float32)
    return float(np.median(np.log2(np.maximum(np.linalg.norm(scaled, axis=(1, 2)), 1e-6))))


def given(value: Any, who: str, size: tuple[int, int]) -> Array:
    """A copy (H, W, 3) of an image that is given, because whoever made it may use the array again.

    Raises:
        UsageError: it has another shape, or is not finite.
    """
    image = np.asarray(value, np.float32)
    if image.ndim != 3 or image.shape[:2] != size or image.shape[2] not in (3, 4) or not np.isfinite(image).all():
        raise UsageError(
            f"the reference of {who} has shape {image.shape}: expected ({size[0]}, {size[1]}, 3) finite numbers, as "
            "the renderer's image has"
        )
    return np.array(image[..., :3], order="C")


def named(view: Any) -> str:
    """What messages call a view."""
    return str(getattr(view, "name", None) or f"a view ({type(view).__name__})")


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
