"""Views, prepared once: where their pixels look, which texels they are made of, and how their errors are counted.

Errors are counted twice, and each counts as much: of linear radiance, and of what a display shows of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import RendererError
from mipbake.base.srgb import linear_to_srgb
from mipbake.fitting.frames import Looked, image_of
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.references import named
from mipbake.fitting.renderer import Array, Levels, Renderer, tiles_of
from mipbake.quality.metrics.images import film_exposure, tonemapped
from mipbake.stochastic import Contributions, contributions, touched_texels

_PARTS = ("", " (linear)")
"""What scores call errors as a display shows them, and those of linear radiance."""

_LOSS = 4.0
"""So many decibels that one part, or one scale, gains make up for one that another loses."""

_LEAST_ERROR = 1e-9
"""A smaller share of an error counts as this, 90 dB: what 8 bits can hold ends before."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A view and what is known of it.

    Args:
        view: what the renderer gets.
        name, scale: of the view.
        size: (height, width) in pixels.
        exposure: what images are multiplied by before they are displayed.
        reference: (P, 6) displayed and linear pixels of the reference.
        weights: (2,) one over the reference's sums of squares: errors count as shares.
        started: (2,) errors, as shares, of the stack that a fit started from.
        shown: (P,) 1 where a pixel shows the maps, and 0 where its error does not count.
        tiles: the tiles that these texels lie in, (T,) increasing, as `mipbake.fitting.renderer.tiles_of` numbers them.
        shares: (levels,) float64, how much of what the pixels read lies in each level; they sum to 1.
        read: which pixels read each texel.
    """

    view: Any
    name: str
    scale: str
    size: tuple[int, int]
    exposure: float
    reference: Array
    weights: NDArray[np.float64]
    started: NDArray[np.float64]
    shown: Array
    tiles: NDArray[np.intp]
    shares: NDArray[np.float64]
    read: Contributions

    @staticmethod
    def of(view: Any, found: Looked, image: Array, parameters: Parameters, wrap: tuple[str, str]) -> Prepared:
        """A view with its reference.

        Args:
            found: what the renderer shows of the stack that the fit starts from.
            image: (H, W, 3) the reference.

        Raises:
            RendererError: the reference is black.
        """
        pixels, shown = image.reshape(-1, 3), found.seen.astype(np.float32)
        if not (pixels[found.seen > 0] > 0).any():
            raise RendererError(
                f"{named(view)}: the reference is black wherever the maps show: expected light on the material"
            )
        exposure = film_exposure(pixels[found.seen > 0])
        reference = _looks(pixels, exposure)
        weights = 1 / _energies(reference, shown)
        started = np.maximum(weights * _energies(_looks(found.image, exposure) - reference, shown), _LEAST_ERROR)
        sizes, uv_da = parameters.sizes, found.uv_da
        touched: NDArray[np.int32]
        if uv_da is not None:
            touched = touched_texels(sizes, found.uv, None, uv_da, found.seen, "anisotropic", wrap)
        else:
            touched = touched_texels(sizes, found.uv, found.lod, None, found.seen, "trilinear", wrap)
        read = contributions(touched)
        return Prepared(
            view,
            named(view),
            str(getattr(view, "scale", "") or "all"),
            found.size,
            exposure,
            reference,
            weights,
            started,
            shown,
            tiles_of(np.asarray(read.elements), parameters.sizes),
            parameters.shares(read),
            read,
        )

    @property
    def visible(self) -> NDArray[np.int32]:
        """The texels that show, (K,) int32, increasing."""
        return np.asarray(self.read.elements)

    @cached_property
    def wanted(self) -> Array:
        """(P, 6) the reference, as `compared` has images."""
        return self.reference * self._factors

    @cached_property
    def _factors(self) -> Array:
        return np.sqrt(self.weights / self.started).astype(np.float32).repeat(3)

    def rendered(self, renderer: Renderer[Any], levels: Levels) -> Array:
        """(P, 3) pixels, as the renderer shows them. RendererError: no image, or one of another size."""
        return image_of(renderer.render(levels, self.view), self.name, self.size).reshape(-1, 3)

    def compared(self, pixels: Array) -> Array:
        """(P, 6) pixels (P, 3) of an image as they are compared.

        The sum of squared differences is the sum of both errors, each as a share of its error at the start of the fit:
        what a view has left counts as much in every view and in both parts.
        """
        return _looks(pixels, self.exposure) * self._factors

    def errors(self, pixels: Array) -> NDArray[np.float64]:
        """(2,) errors of the pixels (P, 3) of an image, as shares of the reference's sums of squares."""
        return self.weights * _energies(_looks(pixels, self.exposure) - self.reference, self.shown)


def _looks(pixels: Array, exposure: float) -> Array:
    """(P, 6) pixels as a display shows them, and as they are. As `mipbake.quality.metrics.displayed` of exposed
    radiance, in float32, which takes a quarter of the time."""
    light: Any = tonemapped(pixels * np.float32(exposure))
    return np.concatenate([np.asarray(linear_to_srgb(light), np.float32), pixels], -1)


def _energies(looks: Array, shown: Array) -> NDArray[np.float64]:
    """(2,) sums of squares of the two halves of (P, 6), over pixels that count."""
    return np.asarray((np.square(looks, dtype=np.float64) * shown[:, None]).sum(0).reshape(2, 3).sum(-1))


def decibels(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """SNR in dB of errors that are shares of 1."""
    return np.asarray(-10 * np.log10(np.maximum(errors, _LEAST_ERROR)))


def worth(gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """What gains are worth, in dB: their mean over both parts, where a loss counts several times.

    Args:
        gains: (..., 2) in dB; NaN where nothing is known, which a mean then is, too.
    """
    return np.asarray(np.where(gains < 0, _LOSS * gains, gains).mean(-1), np.float64)


def scores(views: Sequence[Prepared], errors: NDArray[np.float64]) -> dict[str, float]:
    """Mean SNR in dB of each scale, in the order in which the views name them, and of linear radiance as in
    `near (linear)`.

    Args:
        errors: (views, 2).
    """
    found: dict[str, list[float]] = {}
    for view, row in zip(views, decibels(errors), strict=True):
        for part, snr in zip(_PARTS, row.tolist(), strict=True):
            found.setdefault(view.scale + part, []).append(snr)
    return {scale: sum(each) / len(each) for scale, each in found.items()}


def scores_of_levels(views: Sequence[Prepared], errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(levels, 2) mean SNR in dB of the views, weighed with how much of each level they show; NaN where none does.

    Args:
        errors: (views, 2).
    """
    shares = np.stack([view.shares for view in views])
    shown = np.sum(shares, axis=0)[:, None]
    total = shares.T @ decibels(errors)
    return np.asarray(np.where(shown > 0, total / np.where(shown > 0, shown, 1), np.nan))
