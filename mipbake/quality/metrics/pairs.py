"""Laws of light-view pairs. The sets rank methods differently, so both are always reported.

Adding slope variance to alpha^2 gets the peak of a lobe right, which `near-mirror` sees, and fattens GGX's tails,
which `hemisphere` sees.

A set holds 1,024 pairs, because on glossy materials few pairs carry most of the energy, and 64 pairs leave 1 to 3 dB to
chance. The pairs are stratified, and they come in blocks of 64, so that each block can have surface points of its own.
Figures of a source take weighted pairs, half of which find its lobes (mipbake.quality.reference.pair_sets).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from mipbake.base.names import known_name

Array = NDArray[np.float64]

NEAR_MIRROR_SPREAD = 0.12
"""Standard deviation, in radians, of the light around the mirror direction of the view."""

PAIRS = 1024
"""Pairs of a set that figures are given for."""

BLOCK = 64
"""Pairs that are measured at the same surface points; the next block has points drawn anew."""


@dataclass(frozen=True)
class LightViewPairs:
    """K light and view directions, (K, 3) float32 unit vectors in tangent space, above the horizon."""

    light: NDArray[np.float32]
    view: NDArray[np.float32]

    def __getitem__(self, some: slice) -> LightViewPairs:
        """Some of the pairs."""
        return LightViewPairs(self.light[some], self.view[some])


@dataclass(frozen=True)
class WeightedPairs(LightViewPairs):
    """Light-view pairs that were not drawn by the law of their set, but stand for it.

    Args:
        weights: (K,) so that the mean of weight * g is about the mean of g over all pairs of the set.
    """

    weights: Array

    def __getitem__(self, some: slice) -> WeightedPairs:
        """Some of the pairs."""
        return WeightedPairs(self.light[some], self.view[some], self.weights[some])


def cosine_directions(rng: np.random.Generator, count: int) -> Array:
    """(count, 3) independent unit vectors on the upper hemisphere with density cos(theta) / pi (Malley's method)."""
    return _malley(rng.random(count), rng.random(count))


def near_mirror_lights(rng: np.random.Generator, view: Array) -> Array:
    """(K, 3) lights: the mirror direction of (K, 3) views plus a Gaussian, renormalised; redrawn below the horizon."""
    return _around_mirror(rng, view, rng.standard_normal(view.shape))


def _malley(squared_radius: Array, turn: Array) -> Array:
    radius, angle = np.sqrt(squared_radius), 2 * np.pi * turn
    z = np.sqrt(1 - radius * radius)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def _around_mirror(rng: np.random.Generator, view: Array, normal: Array) -> Array:
    """(K, 3) lights from (K, 3) standard normal numbers, which are drawn again where a light is below the horizon."""
    mirror = view * [-1, -1, 1]
    light = np.zeros_like(view)
    missing = np.arange(len(view))
    while len(missing):
        drawn = mirror[missing] + NEAR_MIRROR_SPREAD * normal
        light[missing] = drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)
        missing = missing[light[missing, 2] <= 0]
        normal = rng.standard_normal((len(missing), 3))
    return light


def grid_cells(rng: np.random.Generator, count: int) -> Array:
    """(count, 2) numbers in [0, 1)^2, one in each cell of a grid, in an order in which every block is stratified as
    well.

    The grid has 2^a by 2^b cells, with a and b as equal as count allows. The order takes the cells by their row and
    column with the bits reversed: any 2^n cells in a row, from a multiple of 2^n on, are spread evenly.
    """
    bits = max(0, count - 1).bit_length()
    across, down = bits // 2, bits - bits // 2
    index = np.arange(1 << bits)
    # Bits of the index go to the column and the row in turn, the first ones to the largest halves.
    column, row = np.zeros_like(index), np.zeros_like(index)
    for bit in range(bits):
        value = index >> bit & 1
        if bit % 2:
            column |= value << (across - 1 - bit // 2)
        else:
            row |= value << (down - 1 - bit // 2)
    # Halves are swapped at random at every step of the division, which keeps the strata.
    column ^= int(rng.integers(1 << across))
    row ^= int(rng.integers(1 << down))
    cells = np.stack([column / (1 << across), row / (1 << down)], -1)
    return np.asarray(cells[:count] + rng.random((count, 2)) / [1 << across, 1 << down])


def in_blocks(order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Dealt to blocks of BLOCK in turn, so that each block is spread like the whole; block by block."""
    blocks = max(1, len(order) // BLOCK)
    return np.concatenate([order[first::blocks] for first in range(blocks)])


def _latin(rng: np.random.Generator, count: int, axes: int) -> Array:
    """(count, axes) numbers in (0, 1), one in each of `count` slices of every axis (McKay et al. 1979)."""
    order = np.stack([rng.permutation(count) for _ in range(axes)], -1)
    return np.asarray((order + np.clip(rng.random((count, axes)), 1e-9, 1 - 1e-9)) / count)


def _stratified_mirror(rng: np.random.Generator, view: Array) -> Array:
    inverse = np.vectorize(NormalDist().inv_cdf, otypes=[np.float64])
    return _around_mirror(rng, view, inverse(_latin(rng, len(view), 3)))


PAIR_SETS: Mapping[str, Callable[[np.random.Generator, Array], Array]] = {
    "near-mirror": near_mirror_lights,
    "hemisphere": lambda rng, view: cosine_directions(rng, len(view)),
}
"""Name of each pair set and how it draws independent lights for given views; views are cosine-distributed."""

_STRATIFIED: Mapping[str, Callable[[np.random.Generator, Array], Array]] = {
    "near-mirror": _stratified_mirror,
    "hemisphere": lambda rng, view: _malley(*rng.permutation(grid_cells(rng, len(view))).T),
}


def pair_set(name: str, seed: int, count: int = PAIRS) -> LightViewPairs:
    """`count` stratified pairs by the law of a pair set, fixed by the seed. UsageError for an unknown name.

    Views are cosine-distributed, one in each cell of a grid; so is every block of BLOCK pairs. Lights of `hemisphere`
    are drawn in the same way and dealt to the views at random. For `near-mirror` each component of the Gaussian is
    stratified, and dealt at random.
    """
    name = known_name("pair set", name, PAIR_SETS)
    rng = np.random.default_rng([seed, list(PAIR_SETS).index(name)])
    view = _malley(*grid_cells(rng, count).T)
    light = _STRATIFIED[name](rng, view)
    return LightViewPairs(light.astype(np.float32), view.astype(np.float32))
