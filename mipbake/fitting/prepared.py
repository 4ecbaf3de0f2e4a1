"""Views, prepared once: their reference, where their pixels look, and which texels they are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import RendererError, UsageError
from mipbake.fitting.comparisons import Comparison, comparisons, decibels, joined
from mipbake.fitting.frames import Looked, image_of, looked, rendered
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.renderer import Array, Levels, Renderer, tiles_of
from mipbake.fitting.supersampled import named, supersampled
from mipbake.material.pixel_filter import PixelFilter
from mipbake.stochastic import Contributions, contributions, touched_texels

TEXELS = ("all", "nearest")

References: TypeAlias = "Sequence[Any] | Callable[[Any], Any]"
"""An image (H, W, 3) for each view, in order; or a function from a view to its image."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A view and what is known of it.

    Args:
        view: what the renderer gets.
        name, scale: of the view.
        size: (height, width) in pixels.
        parts: the ways in which images are compared with the reference, the first of all counts in reports.
        shown: (P,) 1 where a pixel shows the maps, and 0 where its error does not count.
        visible: the texels that show, (K,) int32, increasing.
        tiles: the tiles that these texels lie in, (T,) increasing, as `mipbake.fitting.renderer.tiles_of` numbers them.
        shares: (levels,) float64, how much of what the pixels read lies in each level; they sum to 1.
        credited: which pixels each texel is credited for; empty for a view that is held out.
    """

    view: Any
    name: str
    scale: str
    size: tuple[int, int]
    parts: tuple[Comparison, ...]
    shown: Array
    visible: NDArray[np.int32]
    tiles: NDArray[np.intp]
    shares: NDArray[np.float64]
    credited: Contributions

    @property
    def levels(self) -> list[int]:
        """The levels that show."""
        return [level for level, share in enumerate(self.shares) if share > 0]

    @property
    def started(self) -> list[float]:
        """The error of each part, as a share, of the stack that a fit started from."""
        return [part.started for part in self.parts]

    @cached_property
    def wanted(self) -> Array:
        """(P, 3 parts) the reference, as `compared` has images."""
        return joined(self.parts, [part.reference for part in self.parts])

    def compared(self, pixels: Array) -> Array:
        """(P, 3 parts) pixels (P, 3) of an image as all parts compare them.

        The sum of squared differences is the sum of the errors of the parts, each as a share of its error at the start
        of the fit: what a view has left counts as much in every view and in every part.
        """
        return joined(self.parts, [part.compared(pixels) for part in self.parts])

    def errors(self, pixels: Array) -> NDArray[np.float64]:
        """(parts,) errors of the pixels (P, 3) of an image, as shares of the reference's sums of squares."""
        return np.array([part.error(pixels) for part in self.parts])


@dataclass(frozen=True, eq=False)
class Preparation:
    """How views are prepared.

    Args:
        renderer: what renders. parameters: of the stack. wrap: its addressing.
        texels: which texels a pixel is credited to: "all" that its lookup reads, or the "nearest", as in the paper.
        source: level 0 of the source, for supersampled references; None without.
        kernel: the pixel filter. passes: renders of a reference; None for as many as the level of detail asks for.
        seed: of the offsets.
        error: what is compared, a name in `mipbake.fitting.comparisons.ERRORS`.
    """

    renderer: Renderer[Any]
    parameters: Parameters
    wrap: tuple[str, str]
    texels: str
    source: Levels | None
    kernel: PixelFilter
    passes: int | None
    seed: int
    error: str

    def seen(self, view: Any, levels: Levels) -> tuple[Looked, Array]:
        """Where a view's pixels look these levels up, and its image (H, W, 3). RendererError: a frame that is none."""
        who = named(view)
        frame = self.renderer.render(levels, view)
        return looked(frame, who), image_of(frame, who).copy()  # a renderer may use its arrays again

    def of(self, view: Any, seen: tuple[Looked, Array], given: Any, held_out: bool) -> Prepared:
        """A view, with the reference image that is given, or with a supersampled one in place of None.

        Args:
            seen: of the stack that the fit starts from.

        Raises:
            UsageError: no reference, and no source to make one of.
            RendererError: a frame that is none.
        """
        who, (found, own) = named(view), seen
        footprint = "trilinear" if found.uv_da is None else "anisotropic"
        every = contributions(self._touched(found, footprint))
        if held_out:
            credited = contributions(np.empty((0, 1), np.int32))
        else:
            credited = contributions(self._touched(found, "nearest")) if self.texels == "nearest" else every
        image = self._supersampled(view, found, held_out) if given is None else _given(given, who, found.size)
        pixels, shown = image.reshape(-1, 3), found.seen.astype(np.float32)
        if not (pixels[found.seen > 0] > 0).any():
            raise RendererError(f"{who}: the reference is black wherever the maps show: expected light on the material")
        parts = tuple(part.begun(own.reshape(-1, 3)) for part in comparisons(self.error, pixels, shown))
        visible = np.asarray(every.elements)
        return Prepared(
            view,
            who,
            str(getattr(view, "scale", "") or "all"),
            found.size,
            parts,
            shown,
            visible,
            tiles_of(visible, self.parameters.sizes),
            self.parameters.shares(every),
            credited,
        )

    def _touched(self, found: Looked, texels: str) -> NDArray[np.int32]:
        sizes, uv_da = self.parameters.sizes, found.uv_da
        if uv_da is not None:
            return touched_texels(sizes, found.uv, None, uv_da, found.seen, texels, self.wrap)
        return touched_texels(sizes, found.uv, found.lod, None, found.seen, texels, self.wrap)

    def _supersampled(self, view: Any, found: Looked, held_out: bool) -> Array:
        if self.source is None:
            raise UsageError(
                "neither source nor reference is given: expected the texture set that the stack was baked from, or "
                "reference images"
            )
        lod = _middle_lod(found, self.parameters.sizes[0])
        passes = passes_for(lod, held_out) if self.passes is None else self.passes
        whole = bool(found.seen.all())
        return supersampled(self.renderer, self.source, view, self.kernel, passes, self.seed, whole, found.size)


_LEAST_PASSES, _MOST_PASSES, _CHECKED = 16, 256, 4
"""Renders of a reference: so many at level of detail 0, twice as many at each level more, up to so many; and so many
times as many where a view is held out. Noise in what is learned from averages out over the views (Lehtinen et al.
2018), so more views are better than less noise."""


def passes_for(lod: float, held_out: bool) -> int:
    """Renders of a reference whose pixels see 4^lod texels."""
    passes = int(np.clip(_LEAST_PASSES * 2.0 ** max(lod, 0.0), _LEAST_PASSES, _MOST_PASSES))
    return passes * _CHECKED if held_out else passes


def _middle_lod(found: Looked, size: tuple[int, int]) -> float:
    seen = found.seen > 0
    if found.lod is not None:
        return float(np.median(found.lod[seen]))
    assert found.uv_da is not None
    scaled = found.uv_da[seen].reshape(-1, 2, 2) * np.array([[size[1]], [size[0]]], np.float32)
    return float(np.median(np.log2(np.maximum(np.linalg.norm(scaled, axis=(1, 2)), 1e-6))))


def _given(value: Any, who: str, size: tuple[int, int]) -> Array:
    image = np.asarray(value, np.float32)
    if image.ndim != 3 or image.shape[:2] != size or image.shape[2] not in (3, 4) or not np.isfinite(image).all():
        raise UsageError(
            f"the reference of {who} has shape {image.shape}: expected ({size[0]}, {size[1]}, 3) finite numbers, as "
            "the renderer's image has"
        )
    return np.array(image[..., :3], order="C")  # a copy: whoever made it may use the array again


def render_pixels(renderer: Renderer[Any], levels: Levels, view: Prepared) -> Array:
    """(P, 3) pixels of a prepared view, as the renderer shows them.

    Raises:
        RendererError: no image, or one of another size.
    """
    return rendered(renderer, levels, view.view, view.name, view.size).reshape(-1, 3)


def scores(views: Sequence[Prepared], errors: NDArray[np.float64]) -> dict[str, float]:
    """Mean SNR in dB of each scale and part, in the order in which the views name them.

    Args:
        errors: (views, parts).

    Returns:
        By the name of the scale; from the second part on, with the part's name behind it, as in `near (linear)`.
    """
    found: dict[str, list[float]] = {}
    for view, row in zip(views, decibels(errors), strict=True):
        for index, (part, snr) in enumerate(zip(view.parts, row, strict=True)):
            found.setdefault(f"{view.scale} ({part.name})" if index else view.scale, []).append(float(snr))
    return {scale: sum(each) / len(each) for scale, each in found.items()}


def scores_of_levels(views: Sequence[Prepared], errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(levels, parts) mean SNR in dB of the views, weighed with how much of each level they show; NaN where none does.

    Args:
        errors: (views, parts).
    """
    shares = np.stack([view.shares for view in views])
    shown = np.sum(shares, axis=0)[:, None]
    total = shares.T @ decibels(errors)
    return np.asarray(np.where(shown > 0, total / np.where(shown > 0, shown, 1), np.nan))
