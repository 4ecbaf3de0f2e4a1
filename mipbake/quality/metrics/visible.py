"""Visible error: one differentiable number for how far small pictures look from what is right.

ColorVideoVDP says how films look, takes seconds for each and has no use as an objective of thousands of renders. This
measure stands for it where stacks are judged and trained. It keeps three of the things that such models know of eyes,
and drops the rest:

- The light that a display sends out counts, not the number that encodes it, and it counts against the mean to which
  eyes are adapted.
- Eyes see detail of some sizes better than of others. A picture of SIDE x SIDE pixels is taken apart into cosine bands,
  and each band weighs less the finer it is.
- Eyes see lightness better than two opponent colours.

The error of a picture is the root of its mean square over bands and colours, and the error of some pictures is the mean
of these: so few bright pictures don't decide alone. What bands and colours weigh was fitted to the order that
ColorVideoVDP gives to 252 films of nine sets that were not kept for tests. Two things did not bring these films nearer
to that order: logarithms of light, or its encoding; and detail that hides errors of its own size.
benchmarks/RESULTS-films.md has how this measure ranks films beside ColorVideoVDP.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.base.srgb import srgb_to_linear

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SIDE = 16
"""Pixels a side of a picture: at PIXELS_PER_DEGREE nearly half a degree."""

PIXELS_PER_DEGREE = 37.0
"""Of sight: a 24-inch display of 1920 pixels seen from 0.6 m, as films are judged."""

OPPONENT: Image = np.array([[0.2126, 0.7152, 0.0722], [0.5, -0.5, 0.0], [0.25, 0.25, -0.5]], np.float32)
"""(3, 3): luminance, red against green and yellow against blue, of displayed light."""

UNSEEN = 1e-3
"""Mean square beside which others hardly count: films have 9.5 JOD there."""

_FINEST = 6.0  # cycles per degree at which a band weighs 1 / e; fitted
_MEAN = 0.4  # what the mean of a picture weighs: eyes adapt to it; fitted
_CHROMA = 0.5  # what opponent colours weigh beside luminance: half and a quarter fit alike
_BLACK = 0.02  # light of a display that eyes are adapted to where a picture is black; five times as much fits alike
_RESOLVED = 0.1  # share of the noise below which an error is chance


def _cosines() -> Image:
    """(SIDE, SIDE) orthonormal basis of the discrete cosine transform, frequencies in rows."""
    frequency, place = np.meshgrid(np.arange(SIDE), np.arange(SIDE) + 0.5, indexing="ij")
    basis = np.cos(math.pi * frequency * place / SIDE) * math.sqrt(2 / SIDE)
    basis[0] /= math.sqrt(2)
    return np.asarray(basis, np.float32)


def _sensitivity() -> Image:
    """(3, SIDE, SIDE) of the bands of each opponent colour."""
    each = np.arange(SIDE) * PIXELS_PER_DEGREE / (2 * SIDE)
    weights = np.exp(-np.hypot(each[:, None], each) / _FINEST)
    weights[0, 0] = _MEAN
    return np.stack([weights, _CHROMA * weights, _CHROMA * weights]).astype(np.float32)


COSINES: Image = _cosines()
"""(SIDE, SIDE) basis of the bands, one frequency in each row."""

SENSITIVITY: Image = _sensitivity()
"""(3, SIDE, SIDE) what bands of each opponent colour weigh."""

WEIGHT = float(np.square(SENSITIVITY).sum())
"""What all bands of a picture weigh together."""


def adaptation(light: Image) -> Image:
    """(N, 1, 1, 1) light that eyes are adapted to, of (N, SIDE, SIDE, 3) displayed light: the luminance of its mean,
    and some more, so that black pictures have one."""
    mean = light.reshape(len(light), -1, 3).mean(1) @ OPPONENT[0]
    return np.asarray(mean[:, None, None, None] + _BLACK, np.float32)


def bands(contrasts: Image) -> Image:
    """(N, SIDE, SIDE, 3) displayed light over `adaptation`, or differences of it, to (N, 3, SIDE, SIDE) weighted bands;
    linear."""
    opponent = OPPONENT @ contrasts.reshape(len(contrasts), -1, 3).transpose(0, 2, 1)
    return np.asarray(SENSITIVITY * (COSINES @ opponent.reshape(-1, 3, SIDE, SIDE) @ COSINES.T))


def bands_adjoint(gradient: Image) -> Image:
    """(N, SIDE, SIDE, 3) derivatives by contrasts, from (N, 3, SIDE, SIDE) derivatives by `bands`."""
    opponent = COSINES.T @ (SENSITIVITY * gradient) @ COSINES
    back = OPPONENT.T @ opponent.reshape(len(gradient), 3, -1)
    return np.ascontiguousarray(back.transpose(0, 2, 1)).reshape(-1, SIDE, SIDE, 3)


@dataclass(frozen=True, eq=False)
class VisibleError:
    """What N pictures are off by, in V kinds of as many pictures each, one kind after the other.

    Args:
        off: (N, 3, SIDE, SIDE) bands of the differences to what is right. noise: (N,) mean squares that are chance.
        kinds: V.
    """

    off: Image
    noise: Array
    kinds: int

    @cached_property
    def roots(self) -> Array:
        """(V, N / V) error of each picture, without its noise, beside what nobody sees."""
        squares = np.maximum(mean_squares(self.off) - self.noise, _RESOLVED * self.noise)
        return np.asarray(np.sqrt(squares + UNSEEN).reshape(self.kinds, -1))

    @property
    def means(self) -> Array:
        """(V,) error of each kind."""
        return np.asarray(self.roots.mean(1))

    @property
    def logarithms(self) -> Array:
        """(V,) natural logarithms of the squares of `means`."""
        return 2 * np.log(self.means)

    @property
    def pseudo_values(self) -> Array:
        """(V, N / V) values whose mean is `logarithms`, and whose scatter says how sure it is.

        They are Tukey's pseudo-values, the jackknife over pictures, moved to that mean.
        """
        count = self.roots.shape[1]
        if count < 2:
            return self.logarithms[:, None]
        others = 2 * np.log((self.roots.sum(1, keepdims=True) - self.roots) / (count - 1))
        values = count * self.logarithms[:, None] - (count - 1) * others
        return np.asarray(values - values.mean(1, keepdims=True) + self.logarithms[:, None])

    def weights(self, by: Array) -> NDArray[np.float32]:
        """(N,) derivatives by the sum of squares of each picture's `off`, of what has the derivatives (V,) by
        `logarithms`."""
        each = (by / self.means)[:, None] / (WEIGHT * self.roots.shape[1] * self.roots)
        return np.asarray(each.reshape(-1), np.float32)

    def slopes(self, by: Array) -> Image:
        """(N, SIDE, SIDE, 3) derivatives by contrasts of what has the derivatives (V,) by `logarithms`."""
        return bands_adjoint(2 * self.off * self.weights(by)[:, None, None, None])


def mean_squares(off: Image) -> Array:
    """(N,) means of the squares of (N, 3, SIDE, SIDE) bands, as they weigh."""
    each = off.reshape(len(off), -1)
    return np.asarray(np.einsum("nx,nx->n", each, each) / WEIGHT, np.float64)


def tiles(pictures: NDArray[np.floating]) -> Image:
    """(N, SIDE, SIDE, 3) pieces of (..., H, W, 3) pictures, side by side from the top left; what is left over goes."""
    height, width = (side // SIDE * SIDE for side in pictures.shape[-3:-1])
    cut = np.asarray(pictures[..., :height, :width, :], np.float32)
    rows = cut.reshape(-1, height // SIDE, SIDE, width // SIDE, SIDE, 3)
    return np.asarray(rows.swapaxes(2, 3).reshape(-1, SIDE, SIDE, 3))


def visible_error(candidate: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Mean over pieces of the root mean square of what is seen of the difference between displayed pictures, from 0 up.

    Args:
        candidate, reference: (..., H, W, 3) sRGB-encoded colours in [0, 1], at least SIDE pixels a side; a film is
            (T, H, W, 3).
    """
    right, shown = (tiles(srgb_to_linear(np.clip(each, 0, 1))) for each in (reference, candidate))
    off = bands((shown - right) / adaptation(right))
    return max(float(VisibleError(off, np.zeros(len(off)), 1).means[0]) - math.sqrt(UNSEEN), 0.0)
