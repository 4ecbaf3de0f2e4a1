"""Visible error: one differentiable number for how far small pictures look from what is right.

ColorVideoVDP says how films look, takes seconds for each and has no use as an objective of thousands of renders. This
measure stands for it where stacks are judged and trained. It keeps three of the things that such models know of eyes,
and drops the rest:

- What is displayed counts, as lightness and two opponent colours.
- Eyes see detail of some sizes better than of others. A picture of SIDE x SIDE pixels is taken apart into cosine bands,
  and each band weighs less the finer it is.
- Detail hides errors of its own size. The square of an error in a band counts less the more is right there and in the
  bands around it.

The error of some pictures is the mean over bands, colours and pictures. How fast sensitivity falls, what hides errors
and how much, was fitted to the order that ColorVideoVDP gives to 252 films of nine sets that were not kept for tests.
benchmarks/RESULTS-films.md has how it ranks films beside ColorVideoVDP.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SIDE = 16
"""Pixels a side of a picture: at PIXELS_PER_DEGREE nearly half a degree. A guess."""

PIXELS_PER_DEGREE = 37.0
"""Of sight: a 24-inch display of 1920 pixels seen from 0.6 m, as films are judged."""

OPPONENT: Image = np.array([[0.2126, 0.7152, 0.0722], [0.5, -0.5, 0.0], [0.25, 0.25, -0.5]], np.float32)
"""(3, 3): lightness, red against green and yellow against blue, of sRGB-encoded colours. A guess."""

_FINEST = 3.0  # cycles per degree at which a band weighs 1 / e; fitted
_MEAN = 0.1  # what the mean of a picture weighs: eyes adapt to it; fitted
_CHROMA = 0.5  # what opponent colours weigh beside lightness; fitted
_THRESHOLD = 0.02  # of a band's coefficient that is right, from which it hides errors; fitted
_HIDING = 0.75  # power of what hides; at 1 only relative errors would count; fitted
_UNSEEN = 0.01  # visible error beside which others hardly count: films have 9.8 JOD there; a guess
_RESOLVED = 0.1  # share of the noise below which an error is chance; a guess


def _cosines() -> Image:
    """(SIDE, SIDE) orthonormal basis of the discrete cosine transform, frequencies in rows."""
    frequency, place = np.meshgrid(np.arange(SIDE), np.arange(SIDE) + 0.5, indexing="ij")
    basis = np.cos(math.pi * frequency * place / SIDE) * math.sqrt(2 / SIDE)
    basis[0] /= math.sqrt(2)
    return np.asarray(basis, np.float32)


def _sensitivity() -> Image:
    """(3, SIDE, SIDE) of the bands of each opponent colour."""
    each = np.arange(SIDE) * PIXELS_PER_DEGREE / (2 * SIDE)
    weights = np.exp(-(np.square(each[:, None]) + np.square(each)) / _FINEST**2)
    weights[0, 0] = _MEAN
    return np.stack([weights, _CHROMA * weights, _CHROMA * weights]).astype(np.float32)


COSINES: Image = _cosines()
"""(SIDE, SIDE) basis of the bands, one frequency in each row."""

SENSITIVITY: Image = _sensitivity()
"""(3, SIDE, SIDE) what bands of each opponent colour weigh."""


WEIGHT = float(np.square(SENSITIVITY).sum())
"""What all bands of a picture weigh together."""


def bands(pictures: Image) -> Image:
    """(N, SIDE, SIDE, 3) displayed colours, or differences of them, to (N, 3, SIDE, SIDE) weighted bands; linear."""
    opponent = OPPONENT @ pictures.reshape(len(pictures), -1, 3).transpose(0, 2, 1)
    return np.asarray(SENSITIVITY * (COSINES @ opponent.reshape(-1, 3, SIDE, SIDE) @ COSINES.T))


def bands_adjoint(gradient: Image) -> Image:
    """(N, SIDE, SIDE, 3) derivatives by displayed colours, from (N, 3, SIDE, SIDE) derivatives by `bands`."""
    opponent = COSINES.T @ (SENSITIVITY * gradient) @ COSINES
    back = OPPONENT.T @ opponent.reshape(len(gradient), 3, -1)
    return np.ascontiguousarray(back.transpose(0, 2, 1)).reshape(-1, SIDE, SIDE, 3)


def masked(right: Image) -> Image:
    """(N, 3, SIDE, SIDE) what the squared error of each band counts, of (N, 3, SIDE, SIDE) bands of what is right.

    Detail hides errors in its own band and the eight around it. The mean of a picture hides nothing.
    """
    detail = np.square(right)
    detail[..., 0, 0] = 0
    energy = np.pad(detail, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")
    rows = energy[..., :-2, :] + energy[..., 1:-1, :] + energy[..., 2:, :]
    nearby = (rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:]) / 9
    return np.asarray(np.power(_THRESHOLD**2 + nearby, -_HIDING), np.float32)


@dataclass(frozen=True, eq=False)
class VisibleError:
    """What N pictures are off by, in V kinds of as many pictures each, one kind after the other.

    Args:
        off: (N, 3, SIDE, SIDE) bands of the differences to what is right. counts: (N, 3, SIDE, SIDE), as `masked` has
            them. noise: (V,) mean squares that are chance, as `means` counts.
    """

    off: Image
    counts: Image
    noise: Array

    @property
    def kinds(self) -> int:
        """V."""
        return len(self.noise)

    @cached_property
    def squares(self) -> Array:
        """(V, N / V) mean square of what is off in each picture, noise included."""
        each = np.einsum(
            "nx,nx->n", self.off.reshape(len(self.off), -1), (self.off * self.counts).reshape(len(self.off), -1)
        )
        return np.asarray(each.reshape(self.kinds, -1), np.float64) / WEIGHT

    @property
    def means(self) -> Array:
        """(V,) mean squares of what is off, without the noise, beside what nobody sees."""
        return self._without_noise(self.squares.mean(1))

    @property
    def logarithms(self) -> Array:
        """(V,) natural logarithms of `means`."""
        return np.log(self.means)

    @property
    def pseudo_values(self) -> Array:
        """(V, N / V) values whose mean is `logarithms`, and whose scatter says how sure it is.

        They are Tukey's pseudo-values, the jackknife over pictures, moved to that mean.
        """
        count = self.squares.shape[1]
        if count < 2:
            return self.logarithms[:, None]
        total = self.squares.sum(1, keepdims=True)
        others = np.log(self._without_noise(((total - self.squares) / (count - 1)).T).T)
        values = count * self.logarithms[:, None] - (count - 1) * others
        return np.asarray(values - values.mean(1, keepdims=True) + self.logarithms[:, None])

    def _without_noise(self, squares: Array) -> Array:
        """(..., V) mean squares without their noise, and with what nobody sees."""
        return np.asarray(np.maximum(squares - self.noise, _RESOLVED * self.noise) + _UNSEEN)

    def weights(self, by: Array) -> Image:
        """(N, 3, SIDE, SIDE) derivatives by the squares of `off` of what has the derivatives (V,) by `logarithms`."""
        each = (by / self.means / (WEIGHT * len(self.off) / self.kinds)).astype(np.float32)
        return np.repeat(each, len(self.off) // self.kinds)[:, None, None, None] * self.counts

    def slopes(self, by: Array) -> Image:
        """(N, SIDE, SIDE, 3) derivatives by displayed colours of what has the derivatives (V,) by `logarithms`."""
        return bands_adjoint(2 * self.off * self.weights(by))


def mean_squares(off: Image, counts: Image, kinds: int) -> Array:
    """(V,) means over the pictures of a kind and bands, as they weigh, of (N, 3, SIDE, SIDE) squares that count."""
    return np.asarray(VisibleError(off, counts, np.zeros(kinds)).squares.mean(1))


def tiles(pictures: NDArray[np.floating]) -> Image:
    """(N, SIDE, SIDE, 3) pieces of (..., H, W, 3) pictures, side by side from the top left; what is left over goes."""
    height, width = (side // SIDE * SIDE for side in pictures.shape[-3:-1])
    cut = np.asarray(pictures[..., :height, :width, :], np.float32)
    rows = cut.reshape(-1, height // SIDE, SIDE, width // SIDE, SIDE, 3)
    return np.asarray(rows.swapaxes(2, 3).reshape(-1, SIDE, SIDE, 3))


def visible_error(candidate: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """Mean square of what is seen of the difference between displayed pictures.

    Args:
        candidate, reference: (..., H, W, 3) sRGB-encoded colours in [0, 1], at least SIDE pixels a side; a film is
            (T, H, W, 3).
    """
    right = tiles(reference)
    off = bands(tiles(candidate) - right)
    return float(mean_squares(off, masked(bands(right)), 1)[0])
