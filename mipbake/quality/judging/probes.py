"""Renders of the reference that stacks are judged by: at many points, under many pairs, and as small pictures.

The SNR of a set of pairs varies by decibels from set to set, and on glossy sets from points to points. So each level of
detail is measured in groups: a group is what a figure is quoted for, 64 pairs of each pair set, at points of its own.
Means over groups average both kinds of chance, and their scatter says what is left of it.

Further groups hold pairs alone that would rule a group (pairs.py). Every level of detail is also measured on small
pictures, as people see them (shown.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.judging.pairs import KINDS, SET_SIZE, draw_pairs, draw_pool
from mipbake.quality.judging.shown import Shown, draw_shown
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.estimate import estimate
from mipbake.quality.reference.lighting import GroupPairs
from mipbake.quality.reference.problem import Image, Problem, Region, covered, region_points
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.samplers import frames_at

Array = NDArray[np.float64]

_NOISY = 0.03  # noise energy over the signal's at which samples are doubled
# Level of detail below which stacks come so near the reference that its noise counts: twice the samples.
_FINE = 2.0
_POOLED = 0.1875  # groups of bright pairs of each kind, in units of the others
_FEW, _MORE_GROUPS = 32, 2  # texels a side up to which there are so many times the groups


@dataclass(frozen=True)
class ProbeEffort:
    """How much is rendered at each level of detail.

    Args:
        groups: of pairs, and a part as many of bright pairs; levels of few texels have more.
        points: in each, at most.
        samples: of the reference at each point, twice; more where there are fewer points.
        pictures: small ones, half of them slanted; level 0 has twice as many.
        picture_samples: of the reference at each of their pixels, twice.
        doublings: how often samples are doubled, at most, where the reference stays noisy.
    """

    groups: int = 32
    points: int = 64
    samples: int = 8
    pictures: int = 96
    picture_samples: int = 8
    doublings: int = 3


@dataclass(frozen=True, eq=False)
class Probe:
    """One level of detail: where it is measured, and what is right there.

    Args:
        lod: level of detail of lookups, MIP bias included; `levels` that a lookup reads, one or two.
        groups: of pair sets; those after them hold pairs drawn where renders are bright.
        uv: (G, P frames, 2) of lookups. light, view: (G, K, 3), K = S * 64.
        weights: (S, G, 64) of the pairs of a group, one pair set after the other, in the mean over the pair set.
        mean: (G, K, P, 3) mean of two estimates of the reference. noise: (G, K) what their difference says of it.
        signal: (G, K) mean square of what is right.
        shown: small pictures.
        frames: of each of P points, side by side, whose mean is shown.
    """

    lod: float
    groups: int
    uv: Array
    light: Image
    view: Image
    weights: Array
    mean: Image
    noise: Array
    signal: Array
    shown: Shown
    frames: int

    @property
    def levels(self) -> tuple[int, ...]:
        """What a lookup reads."""
        low = int(self.lod)
        return (low,) if self.lod == low else (low, low + 1)

    def energies(self, squares: Array) -> Array:
        """(S, G) means over the pairs of each group and pair set, of (G, K) mean squares of pairs."""
        return weighed(squares, self.weights)

    @cached_property
    def reference_energies(self) -> Array:
        """(2, S, G) of `noise` and of `signal`."""
        return np.stack([self.energies(self.noise), self.energies(self.signal)])


def probe(problem: Problem, region: Region, lod: float, effort: ProbeEffort, rng: np.random.Generator) -> Probe:
    """Renders of a level of detail, in a region."""
    groups = effort.groups
    height, width = problem.sizes[int(lod)]
    # The reference hardly varies over levels of few texels, and takes many samples there: few points, known well.
    # What chance is in are the pairs.
    points = max(1, min(effort.points // problem.thinned, math.isqrt(height * width)))
    samples = effort.samples * max(1, effort.points // points)
    if lod < _FINE:
        samples *= 2
    if max(height, width) <= _FEW:
        groups *= _MORE_GROUPS
    light, view, weights = _drawn(groups, rng)
    every = len(light)
    spread = region_points(problem, region, every * points, rng)
    uv = rng.permutation(np.resize(spread, (every * points, 2))).reshape(every, points, 2)
    lods = covered(problem, np.full((every, points), lod), rng)
    where = Pixels(uv, lods if problem.sampler.bias else lod)
    mean, noise = _estimated_twice(problem, where, light, view, samples, rng)
    for _ in range(effort.doublings):
        chance, right = (weighed(each, weights)[:, :groups].sum(1) for each in (noise, mean_squares(mean) - noise))
        if (chance < _NOISY * right).all():
            break
        again, of_again = _estimated_twice(problem, where, light, view, samples, rng)
        mean += again
        mean *= np.float32(0.5)
        # Two means of as many samples: errors that know nothing of each other.
        noise = (noise + of_again) / 4
        samples *= 2
    signal = mean_squares(mean) - noise
    # Pictures cover four times as much of the texture with every level, and what they show varies less.
    pictures = round(effort.pictures * max(1.0, 2 ** (1 - lod)))
    shown = draw_shown(problem, region, lod, pictures, effort.picture_samples, rng)
    frames = problem.sampler.frames
    lookups = frames_at(uv, problem.square_pixels(lods), frames)
    return Probe(lod, groups, lookups, light, view, weights, mean, noise, signal, shown, frames)


def weighed(squares: Array, weights: Array) -> Array:
    """(S, G) means of (G, S * 64) squares under (S, G, 64) weights."""
    return np.asarray(np.einsum("sgk,gsk->sg", weights, squares.reshape(len(squares), len(weights), -1)))


def _drawn(groups: int, rng: np.random.Generator) -> tuple[Image, Image, Array]:
    """Lights and views (G, K, 3) of groups, bright pairs last, and what pairs weigh (S, G, 64)."""
    pooled = KINDS * max(2, math.ceil(_POOLED * groups))
    drawn = [draw_pairs(rng, SET_SIZE) for _ in range(groups)]
    weights = np.full((len(PAIR_SETS), groups + pooled, SET_SIZE), 1 / SET_SIZE)
    for index in range(pooled):
        pairs, weights[:, groups + index] = draw_pool(rng, SET_SIZE, index * KINDS // pooled)
        drawn.append(pairs)
    light, view = (np.stack([getattr(each, name) for each in drawn]) for name in ("light", "view"))
    return light, view, weights


def _estimated_twice(
    problem: Problem, where: Pixels, light: Image, view: Image, samples: int, rng: np.random.Generator
) -> tuple[Image, Array]:
    """The mean of two estimates of the reference (G, K, P, 3), and the mean square (G, K) of its noise."""
    lighting = GroupPairs(light, view)
    first, second = (estimate(problem.filtered, where, lighting, samples, rng) for _ in range(2))
    noise = mean_squares((first - second) / np.float32(2))
    first += second
    return np.multiply(first, np.float32(0.5), out=first), noise


def mean_squares(radiance: Image) -> Array:
    """(G, K) mean squares over points and colours, of (G, K, P, 3)."""
    rows = radiance.reshape(*radiance.shape[:2], -1)
    return np.asarray(np.einsum("gkx,gkx->gk", rows, rows).astype(np.float64) / rows.shape[2])
