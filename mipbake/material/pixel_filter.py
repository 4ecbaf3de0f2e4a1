"""Pixel filters, and resampling with them.

A pixel filter p(x, y) = p(x) p(y) is separable and measured in pixels. At level of detail `lod` a pixel covers
2^lod texels of level 0, so the texel weights of a level are p stretched by that factor (equation 3 of Kemppinen et
al. 2023, with the integrand constant over a texel).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.aligned import contiguous
from mipbake.base.names import known_name

Wrap = tuple[str, str]
"""Wrap mode along u and along v, each "wrap" or "clamp"."""

# Steps across a filter's support; a guess, with which the cumulative error of the trapezoid rule stays below 1e-7.
_TABLE = 8192


@dataclass(frozen=True)
class PixelFilter:
    """One axis of a separable pixel filter.

    Args:
        name: what users call it.
        radius: half width of the support, in pixels.
        shape: unnormalised p(x) inside the support; may be negative (mitchell).
    """

    name: str
    radius: float
    shape: Callable[[NDArray[np.float64]], NDArray[np.float64]]

    @cached_property
    def _grid(self) -> NDArray[np.float64]:
        return np.linspace(-self.radius, self.radius, _TABLE + 1)

    @cached_property
    def _cumulative(self) -> NDArray[np.float64]:
        return _integrate(self.shape(self._grid))

    @cached_property
    def _cumulative_magnitude(self) -> NDArray[np.float64]:
        return _integrate(np.abs(self.shape(self._grid)))

    @cached_property
    def signed(self) -> bool:
        """Whether p has negative lobes."""
        return bool((self.shape(self._grid) < 0).any())

    def cumulative(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integral of the normalised p from -infinity to x; any shape, x in pixels, values from 0 to 1."""
        return np.asarray(np.interp(x, self._grid, self._cumulative / self._cumulative[-1]))

    def offsets(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Importance samples of p from uniform numbers u in [0, 1), any shape.

        Returns offsets in pixels, distributed as |p|, and weights of the same shape (constant 1 where p has no
        negative lobe), so that mean(weight * g(offset)) estimates the integral of p g without bias.
        """
        total, magnitude = self._cumulative[-1], self._cumulative_magnitude[-1]
        x = np.interp(u, self._cumulative_magnitude / magnitude, self._grid)
        return x, np.where(self.shape(x) < 0, -1.0, 1.0) * (magnitude / total)


def _integrate(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2)])


def _mitchell(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mitchell and Netravali 1988, equation 8, with B = C = 1/3."""
    x = np.abs(x)
    inner = (7 * x**3 - 12 * x**2 + 16 / 3) / 6
    outer = (-7 / 3 * x**3 + 12 * x**2 - 20 * x + 32 / 3) / 6
    return np.where(x < 1, inner, np.where(x < 2, outer, 0.0))


def _blackman_harris(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Harris 1978, the four-term window with -92 dB side lobes, stretched to radius 2."""
    t = 2 * np.pi * (x + 2) / 4
    return 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)


FILTERS: Mapping[str, PixelFilter] = {
    f.name: f
    for f in (
        PixelFilter("gaussian", 2.0, lambda x: np.exp(-2 * x * x)),  # sigma 0.5
        PixelFilter("box", 0.5, np.ones_like),
        PixelFilter("tent", 1.0, lambda x: 1 - np.abs(x)),
        PixelFilter("mitchell", 2.0, _mitchell),
        PixelFilter("blackman-harris", 2.0, _blackman_harris),
    )
}


def filter_named(name: str) -> PixelFilter:
    """The filter of that name; UsageError with the list of names when there is none."""
    return FILTERS[known_name("pixel filter", name, FILTERS)]


def level_sizes(height: int, width: int) -> list[tuple[int, int]]:
    """(height, width) of every level of a complete chain to 1 x 1: max(1, floor(size / 2^L))."""
    count = max(height, width).bit_length()
    return [(max(1, height >> level), max(1, width >> level)) for level in range(count)]


def resample_weights(
    n_in: int, n_out: int, pixel_filter: str, wrap: str, width: float = 1.0
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Polyphase weights of one axis, from n_in texels to n_out <= n_in, any two sizes.

    Output i is centred at (i + 1/2) n_in / n_out; texel j weighs the integral of p over its extent, with p's unit
    stretched to `width` output texels. With `box` that is exact area averaging.

    Returns:
        Source indices (n_out, taps), wrapped or clamped into range, and weights (n_out, taps) whose rows sum to 1.
    """
    kernel = filter_named(pixel_filter)
    texels_per_output = n_in / n_out
    scale = texels_per_output * width
    centre = (np.arange(n_out) + 0.5) * texels_per_output
    first = np.floor(centre - kernel.radius * scale + 1e-9).astype(np.int64)
    taps = int((np.ceil(centre + kernel.radius * scale - 1e-9).astype(np.int64) - first).max())
    index = first[:, None] + np.arange(taps)
    edges = (first[:, None] + np.arange(taps + 1) - centre[:, None]) / scale
    weights = np.diff(kernel.cumulative(edges), axis=1)
    weights /= weights.sum(1, keepdims=True)
    index = index % n_in if wrap == "wrap" else np.clip(index, 0, n_in - 1)
    return index, weights.astype(np.float32)


Taps = tuple[NDArray[np.int64], NDArray[np.float32]]
"""One axis of a resampling, as resample_weights gives it."""


def resample_taps(image: NDArray[np.float32], rows: Taps, columns: Taps) -> NDArray[np.float32]:
    """(H, W, C) float32 to (h, w, C): rows first, then columns, each output the weighted sum of its taps.

    Args:
        image: whose rows may lie apart; it is copied where the texels of a row do.
        rows, columns: indices below H and W, and weights. An axis of one tap is copied, whatever its weights.
    """
    from mipbake import _native

    texel = image.itemsize * image.shape[2]
    if image.strides[1:] != (texel, image.itemsize) or image.strides[0] % image.itemsize or not image.flags.aligned:
        image = contiguous(image)
    out = memory.empty((len(rows[0]), len(columns[0]), image.shape[2]))
    _native.resample(image, *rows, *columns, out)
    return out


def resample(
    image: NDArray[np.float32], size: tuple[int, int], pixel_filter: str, wrap: Wrap, width: float = 1.0
) -> NDArray[np.float32]:
    """(H, W, C) to (size[0], size[1], C), no larger than the input, each axis with resample_weights."""
    rows = resample_weights(image.shape[0], size[0], pixel_filter, wrap[1], width)
    columns = resample_weights(image.shape[1], size[1], pixel_filter, wrap[0], width)
    return resample_taps(image, rows, columns)


PRE_REDUCED = 3
"""A level is filtered from box averages 2^3 times finer than itself: it costs the eighth part of a texel in the
filter's width (variance + 1/768 pixel^2, exact for `box`) and makes the whole chain as cheap as its first levels."""


# The least cosine of a view for the shape of pixels, and the sine below which pixels are square.
_LEAST_SLANT, _FACE_ON = 0.1, 1e-6


def slanted_axes(view: NDArray[np.floating]) -> NDArray[np.floating]:
    """Axes of a pixel on the surface that it shows: (..., 3) unit views in the tangent frame to (..., 2, 2).

    A pixel that is square on the screen reaches farthest along the view, by which its level of detail is chosen: that
    is the first axis, a unit vector. The second, across, is as long as the cosine of the view. Axes are (u, v), and v
    runs against +y of the tangent frame.
    """
    length = np.linalg.norm(view[..., :2], axis=-1, keepdims=True)
    along = np.where(length > _FACE_ON, view[..., :2] / np.maximum(length, _FACE_ON) * [1.0, -1.0], [1.0, 0.0])
    across = np.stack([-along[..., 1], along[..., 0]], -1) * np.maximum(view[..., 2:], _LEAST_SLANT)
    return np.stack([along, across], -2).astype(view.dtype)


def reduced_size(sizes: Sequence[tuple[int, int]], level: int, wrap: Wrap) -> tuple[int, int]:
    """(height, width) of the box averages that a level above PRE_REDUCED is filtered from.

    Not smaller along a clamped axis: what lies beyond its border is the edge texel of level 0, not the edge average.
    """
    reduced = sizes[level - PRE_REDUCED]
    rows, columns = (reduced[i] if wrap[1 - i] == "wrap" else sizes[0][i] for i in (0, 1))
    return rows, columns


def filtered_levels(
    image: NDArray[np.float32],
    pixel_filter: str,
    wrap: Wrap,
    progress: Callable[[float], None] = lambda _: None,
) -> list[NDArray[np.float32]]:
    """Averages of (H, W, C) under the pixel filter at every level of a complete chain, level 0 included.

    With `box` level 0 is the image itself, not a copy.
    """
    sizes = level_sizes(*image.shape[:2])
    finer = image
    levels = []
    for level, size in enumerate(sizes):
        if level > PRE_REDUCED:
            finer = resample(finer, reduced_size(sizes, level, wrap), "box", wrap)
        unchanged = level == 0 and pixel_filter == "box"
        levels.append(image if unchanged else resample(finer, size, pixel_filter, wrap))
        progress((level + 1) / len(sizes))
    return levels
