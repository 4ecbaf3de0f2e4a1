"""Samples of pixels: places on level 0 that lie around a pixel's centre as the pixel filter weighs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mipbake.material.pixel_filter import filter_named
from mipbake.quality.reference.sequences import SEQUENCE

Image = NDArray[np.float32]

Generators = np.random.Generator | Sequence[np.random.Generator]
"""What draws random numbers: for all groups, or for each of them by itself."""

_T = TypeVar("_T", bound=np.generic)

_BITS = 14  # of the number of bins
_BINS = 1 << _BITS  # not tuned


@dataclass(frozen=True, eq=False)
class _Bins:
    """One axis of a pixel filter p, cut into bins that are equally likely under |p|.

    Args:
        start, width: (_BINS,) of each bin, in pixels.
        weight: (_BINS,) the integral of p over each bin, times _BINS; None for a filter without negative lobes, where
            all are 1.
    """

    start: Image
    width: Image
    weight: Image | None


@lru_cache(maxsize=8)
def _bins(pixel_filter: str) -> _Bins:
    kernel = filter_named(pixel_filter)
    edges, _ = kernel.offsets(np.arange(_BINS + 1) / _BINS)
    weight = (np.diff(kernel.cumulative(edges)) * _BINS).astype(np.float32) if kernel.signed else None
    return _Bins(edges[:-1].astype(np.float32), np.diff(edges).astype(np.float32), weight)


@lru_cache(maxsize=64)
def _steps(count: int) -> NDArray[np.intp]:
    """(2, count) steps from bin to bin along each axis: the additive recurrence, cut to whole bins."""
    fraction = 32  # bits that the recurrence is held in: products of whole numbers are exact
    steps = np.stack([np.arange(count) * round(each * 2**fraction) >> fraction - _BITS for each in SEQUENCE])
    return (steps & _BINS - 1).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Pixels:
    """Where pixels lie, and what each of them covers.

    Args:
        uv: (P, 2) centres; or (G, P, 2) where each of G groups has pixels of its own.
        lod: level of detail, of all pixels or as an array that broadcasts to (G, P). A pixel is 2^lod texels wide.
        axes: axes of a pixel on the surface in units of that width, an array that broadcasts to (G, P, 2, 2): the
            offset (x, y) of the pixel filter is x times the first axis and y times the second, along u and v. None for
            square pixels.
    """

    uv: NDArray[np.floating]
    lod: float | NDArray[np.floating]
    axes: NDArray[np.floating] | None = None


class Span(NamedTuple):
    """Some groups and some pixels."""

    groups: slice
    pixels: slice

    def inside(self, whole: Span) -> Span:
        """The same, counted from where a whole begins that this is a part of."""
        return Span(*(slice(a.start - b.start, a.stop - b.start) for a, b in zip(self, whole, strict=True)))


class Samples:
    """Samples of pixels, for groups that look their pixels up by themselves.

    The uniform numbers of a pixel are an additive recurrence under a random shift (Cranley and Patterson 1976). Each
    of them is uniform, so that no mean is biased, and numbers that follow each other cover the filter evenly. Groups
    that share pixels continue each other's sequence.

    A uniform number is a bin of the filter and a place in the bin. The sequence steps from bin to bin, in whole
    numbers; the shift decides on the place. So an offset may take any value, and costs two reads of a table, where
    inverting the filter at every sample costs several times as much. Inside a bin places are uniform. That is not quite
    the filter's density where bins are wide, in the thin tails: integrals still agree with quadrature to four digits
    (tests/test_reference.py).

    Args:
        size: (width, height) of level 0.
        groups: that look pixels up. samples: of each pixel, in each group.
        rng: one for all, or one for each group, where groups have pixels of their own.
    """

    def __init__(
        self,
        pixel_filter: str,
        size: tuple[int, int],
        pixels: Pixels,
        groups: int,
        samples: int,
        rng: Generators,
    ) -> None:
        self._bins = _bins(pixel_filter)
        uv = np.asarray(pixels.uv, np.float32)
        uv = uv.reshape(-1, *uv.shape[-2:])
        own, count, _ = uv.shape
        # From here on the axes are: u and v; groups; samples; pixels. Axes of size 1 repeat.
        shift = _uniform(rng, own, count) * _BINS
        self._first = shift.astype(np.intp)
        self._inside = (shift - self._first).astype(np.float32)
        self._steps = _steps(samples * (groups if own == 1 else 1)).reshape(2, -1, samples, 1)
        self._centre = np.ascontiguousarray(uv.transpose(2, 0, 1))[:, :, None]
        texels = np.atleast_2d(np.exp2(np.asarray(pixels.lod, np.float32)))[:, None]
        self._reach = [texels / np.float32(side) for side in size]
        self._axes = None if pixels.axes is None else _planes(np.asarray(pixels.axes, np.float32))

    def at(self, span: Span) -> tuple[Image, Image | None]:
        """(R, S, n, 2) uv of the samples of some pixels in some groups, and (R, S, n) their weights, 1 in the mean;
        None where all are 1."""
        (x, of_x), (y, of_y) = (self._offsets(axis, span) for axis in range(2))
        if self._axes is not None:
            along, across = ([_within(each, span) for each in axis] for axis in self._axes)
            x, y = x * along[0] + y * across[0], x * along[1] + y * across[1]
        uv = np.empty((*x.shape, 2), np.float32)
        for axis, offset in enumerate((x, y)):
            np.multiply(offset, _within(self._reach[axis], span), out=offset)
            np.add(offset, _within(self._centre[axis], span), out=uv[..., axis])
        return uv, None if of_x is None or of_y is None else of_x * of_y

    def centres(self, span: Span) -> Image:
        """(R, 1, n, 2) uv of the pixels themselves; R is 1 where groups share pixels."""
        return np.stack([_within(each, span) for each in self._centre], -1)

    def _offsets(self, axis: int, span: Span) -> tuple[Image, Image | None]:
        """(R, S, n) offsets along one axis, in pixels, and their weights."""
        bins = self._bins
        index = _within(self._first[axis], span) + _within(self._steps[axis], span)
        index &= _BINS - 1
        offset = bins.width.take(index)
        offset *= _within(self._inside[axis], span)
        offset += bins.start.take(index)
        return offset, None if bins.weight is None else bins.weight.take(index)


def _uniform(rng: Generators, own: int, count: int) -> NDArray[np.float64]:
    """(2, own, 1, count) uniform numbers."""
    if not isinstance(rng, Sequence):
        return rng.random((2, own, 1, count))
    if len(rng) != own:
        raise AssertionError(f"{len(rng)} generators for {own} groups of pixels")
    return np.concatenate([each.random((2, 1, 1, count)) for each in rng], 1)


def _planes(axes: Image) -> Image:
    """(2, 2, G, 1, P) of (..., 2, 2) axes: which axis of a pixel, and its part along u and v."""
    whole = axes.reshape(*(1,) * (4 - axes.ndim), *axes.shape)
    return np.asarray(whole.transpose(2, 3, 0, 1)[:, :, :, None])


def _within(values: NDArray[_T], span: Span) -> NDArray[_T]:
    """Some groups and pixels of (G, S, P), whose axes of size 1 stand for all."""
    groups, _, pixels = values.shape
    return values[span.groups if groups > 1 else slice(None), :, span.pixels if pixels > 1 else slice(None)]
