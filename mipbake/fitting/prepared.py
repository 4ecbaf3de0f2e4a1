"""Views, prepared once: where their pixels look, which texels they are made of, and how their errors are counted.

Errors are counted twice, and each counts as much: of linear radiance, and of what a display shows of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import RendererError
from mipbake.base.srgb import linear_to_srgb
from mipbake.fitting.frames import image_of, named
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.program import Frame
from mipbake.fitting.renderer import Array, Levels, Renderer, tiles_of
from mipbake.quality.metrics.images import film_exposure, tonemapped
from mipbake.stochastic import Contributions, contributions, touched_texels

_PARTS = ("", " (linear)")
"""What scores call errors as a display shows them, and those of linear radiance."""

_LOSS = 4.0
"""So many decibels that one part, or one scale, gains make up for one that another loses."""

_LEAST_ERROR = 1e-9
"""A smaller share of an error counts as this, 90 dB: what 8 bits can hold ends before."""

_CERTAIN = 0.1
"""What noise of a reference leaves of an error is at least this share of it: where the noise is most of the error,
nobody knows what is left."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A view and what is known of it.

    Args:
        view: what the renderer gets.
        name, scale: of the view.
        size: (height, width) in pixels.
        begun: (P, 3) pixels of the stack that a fit starts from.
        shown: (P,) 1 where a pixel shows the maps, and 0 where its error does not count.
        tiles: that these texels lie in, as `mipbake.fitting.renderer.tiles_of` has them.
        shares: (levels,) float64, how much of what the pixels read lies in each level; they sum to 1.
        read: which pixels read each texel.
        exposure: what images are multiplied by before they are displayed.
        reference: (P, 6) displayed and linear pixels of the reference.
        weights: (2,) one over the reference's sums of squares: errors count as shares.
        noise: (2,) how much of an error is the reference's own noise, as a share: an estimate.
    """

    view: Any
    name: str
    scale: str
    size: tuple[int, int]
    begun: Array
    shown: Array
    tiles: NDArray[np.intp]
    shares: NDArray[np.float64]
    read: Contributions
    exposure: float
    reference: Array
    weights: NDArray[np.float64]
    noise: NDArray[np.float64]

    @staticmethod
    def of(view: Any, found: Frame, halves: Array, parameters: Parameters, wrap: tuple[str, str]) -> Prepared:
        """A view with its reference, as `aiming_at` has it.

        Args:
            found: what the renderer shows of the stack that the fit starts from, as `looked` gives it.
        """
        image, seen = found.image.reshape(-1, 3), found.id.reshape(-1)
        lod = None if found.lod is None else found.lod.reshape(-1)
        uv_da = None if found.uv_da is None else found.uv_da.reshape(-1, 4)
        lookup = "trilinear" if uv_da is None else "anisotropic"
        uv: Array = found.uv.reshape(-1, 2)
        read = contributions(touched_texels(parameters.sizes, uv, lod, uv_da, seen.astype(np.uint8), lookup, wrap))
        unknown = np.zeros(2)
        return Prepared(
            view,
            named(view),
            str(getattr(view, "scale", "") or "all"),
            found.id.shape,
            image,
            seen.astype(np.float32),
            tiles_of(np.asarray(read.elements), parameters.sizes),
            parameters.shares(read),
            read,
            1.0,
            image,
            *(unknown, unknown),
        ).aiming_at(halves)

    def aiming_at(self, halves: Array) -> Prepared:
        """The same view with another estimate of its reference.

        A display shows less of a mean of few noisy renders than of their limit, because its curve bends. What it shows
        of the halves lacks twice as much in the mean; the jackknife takes the difference off (Quenouille 1956, *Notes
        on Bias in Estimation*).

        Args:
            halves: (2, H, W, 3) two estimates that know nothing of each other, or the same twice.

        Raises:
            RendererError: the reference is black.
        """
        first, second = halves.reshape(2, -1, 3)
        pixels, seen = np.asarray((first + second) / 2, np.float32), self.shown > 0
        if not (pixels[seen] > 0).any():
            raise RendererError(
                f"{self.name}: the reference is black wherever the maps show: expected light on the material"
            )
        exposure = film_exposure(pixels[seen])
        sides = _looks(first, exposure), _looks(second, exposure)
        reference = np.asarray(2 * _looks(pixels, exposure) - (sides[0] + sides[1]) / 2, np.float32)
        weights = 1 / _energies(reference, self.shown)
        noise = weights * _energies(sides[0] - sides[1], self.shown) / 4
        return replace(self, exposure=exposure, reference=reference, weights=weights, noise=noise)

    @cached_property
    def started(self) -> NDArray[np.float64]:
        """(2,) errors, as shares, of the stack that a fit starts from."""
        return np.maximum(self.errors(self.begun), _LEAST_ERROR)

    @property
    def uncertainty(self) -> float:
        """Noise of the reference over the error that the fit began with, of the part where that is larger."""
        return float((self.noise / self.started).max())

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
        """(P, 6) pixels (P, 3) of an image as they are compared: the sum of squared differences is the sum of both
        errors, each as a share of its error at the start of the fit. So all views and both parts count alike."""
        return _looks(pixels, self.exposure) * self._factors

    def errors(self, pixels: Array) -> NDArray[np.float64]:
        """(2,) errors of the pixels (P, 3) of an image, as shares of the reference's sums of squares, without what is
        the reference's own noise."""
        whole = self.weights * _energies(_looks(pixels, self.exposure) - self.reference, self.shown)
        return np.asarray(np.maximum(whole - self.noise, _CERTAIN * whole))


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


def shown(views: Sequence[Prepared]) -> NDArray[np.bool_]:
    """(levels,) whether any of the views shows it."""
    return np.asarray(np.sum([view.shares for view in views], axis=0) > 0)


def started(views: Sequence[Prepared]) -> dict[str, float]:
    """Scores of the stack that a fit starts from."""
    return scores(views, np.array([view.started for view in views]))


def worth(gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """What gains (..., 2) are worth, in dB: their mean over both parts, where a loss counts several times."""
    return np.asarray(np.where(gains < 0, _LOSS * gains, gains).mean(-1), np.float64)


def scores(views: Sequence[Prepared], errors: NDArray[np.float64]) -> dict[str, float]:
    """Mean SNR in dB of each scale, in the order in which the views name them, and of linear radiance as in
    `near (linear)`, of errors (views, 2)."""
    found: dict[str, list[float]] = {}
    for view, row in zip(views, decibels(errors), strict=True):
        for part, snr in zip(_PARTS, row.tolist(), strict=True):
            found.setdefault(view.scale + part, []).append(snr)
    return {scale: sum(each) / len(each) for scale, each in found.items()}


def gains_of_levels(
    views: Sequence[Prepared], before: NDArray[np.float64], after: NDArray[np.float64], sure: bool = True
) -> NDArray[np.float64]:
    """(levels,) what views gain between errors (views, 2), as `worth` has it; NaN for a level that none shows.

    Each view is weighed with how much of the level it shows. Where a gain should be sure, the standard error is taken
    off the mean gain of each part: the best of many states is often one that chance favours in few views, and is worse
    in others.
    """
    shares = np.stack([view.shares for view in views])
    gains = decibels(after) - decibels(before)
    total = shares.sum(0)[:, None]
    known = np.where(total > 0, total, 1)
    mean = shares.T @ gains / known
    spread = np.sqrt(np.einsum("vl,vlp->lp", np.square(shares), np.square(gains[:, None] - mean))) / known
    return np.where(total[:, 0] > 0, worth(mean - spread if sure else mean), np.nan)
