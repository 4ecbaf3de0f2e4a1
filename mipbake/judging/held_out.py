"""Measuring stacks against the reference while they are optimised: held-out pairs at fixed pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.metrics.pairs import PAIR_SETS, LightViewPairs, cosine_directions
from mipbake.metrics.snr import snr_from_sums, snr_sums
from mipbake.reference.estimate import reference
from mipbake.reference.problem import Image, Problem, Region, region_points

SET_SIZE = 64
"""Pairs of the sets that figures are quoted for (mipbake.metrics.pairs.pair_set)."""

_HELD_OUT_STREAM = 104729  # keeps these pairs apart from every set that pair_set draws


@dataclass(frozen=True)
class HeldOutEffort:
    """How much is rendered.

    Args:
        points: pixels for each level of detail. pairs: of each pair set.
        samples: of the reference at a pixel of level 0; they double with every level up to the third.
    """

    points: int
    pairs: int
    samples: int

    def part(self, count: int) -> HeldOutEffort:
        """One of so many parts of the points and the pairs."""
        return replace(self, points=max(1, self.points // count), pairs=max(2, self.pairs // count))


class HeldOut:
    """Reference renders of held-out pairs at fixed pixels, to measure any stack by.

    The SNR of a set of pairs hangs on its few brightest, so it varies by decibels from one set of 64 to the next. So
    several sets are measured.

    Args:
        region: where the pixels lie, and for which levels: levels of detail run from the first to the last of them in
            steps of 1/2, and half a level further where there is one more.
        stream: of random numbers.
    """

    def __init__(self, problem: Problem, region: Region, effort: HeldOutEffort, stream: list[int]) -> None:
        self._problem, self.each = problem, effort.pairs
        self.lods = [level + half for level in region.levels for half in (0.0, 0.5) if level + half <= problem.last]
        rng = np.random.default_rng([_HELD_OUT_STREAM, *stream])
        self.pairs = draw_pairs(rng, self.each)
        self._renders = [
            (uv, *estimates)
            for lod in self.lods
            for uv in [region_points(problem, region, lod, effort.points, rng)]
            for estimates in [estimate_twice(problem, uv, lod, self.pairs, effort.samples, rng)]
        ]
        self._fixed = [snr_sums(first, first, second) / len(uv) for uv, first, second in self._renders]

    def sums(self, levels: Sequence[Image], index: int) -> NDArray[np.float64]:
        """(S, K, 3) signal, error and noise of every pair of S pair sets, means over pixels (metrics.snr.snr_sums)."""
        from mipbake.render import candidate

        uv, first, second = self._renders[index]
        problem = self._problem
        shaded = candidate(levels, problem.target, problem.wrap, uv, self.lods[index], self.pairs)
        out = self._fixed[index].copy()
        # In float32: a sum over pixels and colours rounds by far less than it varies.
        out[:, 1] = np.einsum("kpc,kpc->k", shaded - first, shaded - second) / len(uv)
        return np.asarray(out.reshape(-1, self.each, 3))

    def log_errors(self, levels: Sequence[Image], index: int) -> NDArray[np.float64]:
        """(S, G) natural logarithm of the error relative to the signal, of G sets of pairs like each of S pair sets.

        0 where nothing is lit.
        """
        sums = self.sums(levels, index)
        groups = max(1, self.each // SET_SIZE)
        sums = sums[:, : self.each // groups * groups].reshape(len(sums), groups, -1, 3).sum(2)
        return np.nan_to_num(-snr_from_sums(sums) * (math.log(10) / 10))

    def typical(self, levels: Sequence[Image]) -> NDArray[np.float64]:
        """(S, M) means over sets of pairs of `log_errors` at every level of detail."""
        return np.stack([self.log_errors(levels, index).mean(-1) for index in range(len(self.lods))], 1)


def draw_pairs(rng: np.random.Generator, each: int) -> LightViewPairs:
    """`each` random pairs drawn like every pair set in turn."""
    views = [cosine_directions(rng, each) for _ in PAIR_SETS]
    lights = [draw(rng, view) for draw, view in zip(PAIR_SETS.values(), views, strict=True)]
    return LightViewPairs(np.concatenate(lights).astype(np.float32), np.concatenate(views).astype(np.float32))


def estimate_twice(
    problem: Problem,
    uv: NDArray[np.float64],
    lod: float,
    pairs: LightViewPairs,
    samples: int,
    rng: np.random.Generator,
) -> tuple[Image, Image]:
    """Two independent estimates of the reference, (K, P, 3) each: pixels of coarse levels cover more texels."""
    samples = int(samples * 2 ** min(round(lod), 3))
    source = problem.filtered
    return reference(source, uv, lod, pairs, samples, rng), reference(source, uv, lod, pairs, samples, rng)
