"""Scores of ingredients and blends against the reference, at many points under many pairs, from looked-up texels alone.

The SNR of a set of pairs varies by decibels from set to set, and on glossy sets from points to points. So each level of
detail is measured in groups: a group is what a figure is quoted for, 64 pairs of each pair set, at points of its own.
Means over groups average both kinds of chance, and their scatter says what is left of it.

A group that holds a grazing pair, or one that hits a narrow lobe, is ruled by it, and means over groups hardly see
those. So the energy of errors is measured for such pairs by themselves (bright_pairs.py).

Ingredients are looked up once at all points. A level that blends ingredients blends what was looked up, since lookups
are linear in stored channels, so blends cost a shading each and no images.

SNR under single lights follows the brightest pairs. What people look at is lit from everywhere and tonemapped: dim
renders and casts of colour count there. So every level of detail is also measured under a studio's lights, on surfaces
turned every way to the viewer, as a display shows them (lit_renders.py).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.judging.bright_pairs import KINDS, draw_pool
from mipbake.judging.held_out import SET_SIZE, draw_pairs
from mipbake.judging.lit_renders import displayed, lit_error, lit_radiance, lit_reference, placed, room
from mipbake.metrics.pairs import PAIR_SETS
from mipbake.reference.estimate import estimate, look_up
from mipbake.reference.lighting import GroupPairs
from mipbake.reference.problem import Image, Problem, region_points, whole
from mipbake.reference.samples import Pixels
from mipbake.render.environment import studio
from mipbake.shading import shade

Array = NDArray[np.float64]

_STREAM = 15485863  # keeps these pairs apart from every set that pair_set draws
DECIBEL = 10 / math.log(10)
FLOOR = 1e-7  # error in units of the signal that is as good as none
_RESOLVED = 0.01  # share of the reference's noise energy below which an error is chance (metrics.snr)
_MAGNIFIED = 0.7  # levels of detail below 0 that count for level 0
_UNSURE = 0.35  # standard error of a logarithm
_NOISY, _MOST_AGAIN = 0.03, 3  # noise energy over the signal's at which samples are doubled, so many times at most
_FINE = 2.0  # level of detail below which stacks come so near the reference that its noise counts: twice the samples
UNLIT = 1e-12  # mean square radiance below which nothing is seen
_POOLED = 0.1875  # groups of bright pairs of each kind, in units of the others
_FEW, _MORE_GROUPS = 32, 2  # texels a side up to which there are so many times the groups
_RADIANCES = 1 << 16  # at a time: they stay in the cache


@dataclass(frozen=True)
class Effort:
    """How much is rendered at each level of detail.

    Args:
        groups: of pairs, and a part as many of bright pairs; levels of few texels have more.
        points: in each, at most.
        samples: of the reference at each point, twice; more where there are fewer points.
        lit_points, lit_samples: under the studio's lights.
    """

    groups: int = 32
    points: int = 64
    samples: int = 8
    lit_points: int = 1024
    lit_samples: int = 16


@dataclass(frozen=True, eq=False)
class Score:
    """What a stack is off by at a level of detail.

    Args:
        log_errors: (S, G) natural logarithms of the error relative to the signal, of S pair sets and G groups.
        pooled: (2 S, H) of the energy of the errors under bright pairs of each kind relative to the energy of the
            signal; values whose mean it is, and whose scatter says how sure (Tukey's pseudo-values: the jackknife over
            groups).
        lit: tonemapped error under the studio's lights. lit_log: LitError.logarithm, half of it brightness by angle.
        plain: (S, G) log_errors of the best rule of engines and tools, another one in every group. Only in what is
            asked for.
        sure: (T,) what each term counts, from 0 to 1; None for what its own scatter says (`trust`).
    """

    log_errors: Array
    pooled: Array
    lit: float
    lit_log: float
    plain: Array | None = None
    sure: Array | None = None

    @property
    def rows(self) -> list[Array]:
        """All rows: first the rows of log_errors, then the rows of pooled."""
        return [*self.log_errors, *self.pooled]

    @property
    def means(self) -> Array:
        """(3 S,) means of the rows."""
        return np.append(self.log_errors.mean(1), self.pooled.mean(1))

    @property
    def terms(self) -> Array:
        """(T,) the terms of weights.TERMS."""
        return np.append(self.means, self.lit_log)

    @property
    def trust(self) -> Array:
        """(T,) what each term counts: 1, and less for bright pairs on which chance decides."""
        if self.sure is not None:
            return self.sure
        return np.concatenate([np.ones(len(self.log_errors)), certainty(self.pooled), [1.0]])

    @property
    def decibels(self) -> Array:
        """(S,) SNR, the mean over groups."""
        return np.asarray(-DECIBEL * self.log_errors.mean(1))


def certainty(rows: Array) -> Array:
    """(...,) of rows (..., H) of pseudo-values: 1 for a mean that is known, 1/2 where its standard error is _UNSURE.

    Highlights of polished tiles are seen by one pair in thousands, and the few bright pairs that hit them say anything.
    """
    error = rows.std(-1) / math.sqrt(max(1, rows.shape[-1] - 1))
    return np.asarray(1 / (1 + np.square(error / _UNSURE)))


@dataclass(frozen=True, eq=False)
class Probe:
    """One level of detail: where it is measured, and what is right there.

    Args:
        lod: level of detail; `levels` that a lookup reads, one or two.
        groups: of pair sets; those after them hold pairs drawn where renders are bright.
        uv: (G, P, 2). light, view: (G, K, 3), K = S * 64.
        weights: (S, G, 64) of the pairs of a group, one pair set after the other, in the mean over the pair set.
        mean: (G, K, P, 3) mean of two estimates of the reference. noise: (S, G) what their difference says of it.
        signal: (S, G).
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
    lit_uv: Array
    frame: Image
    lit_view: Image
    displayed: Image

    @property
    def levels(self) -> tuple[int, ...]:
        low = int(self.lod)
        return (low,) if self.lod == low else (low, low + 1)


class Scores:
    """Probes of every level of detail of a problem in steps of 1/2, and the scores of looked-up texels."""

    def __init__(self, problem: Problem, effort: Effort, seed: int, lods: Sequence[float] | None = None) -> None:
        self.problem, self.effort = problem, effort
        self.lods = [lod / 2 for lod in range(2 * problem.last + 1)] if lods is None else list(lods)
        self.lighting = studio()
        self.probes = [self._probe(lod, np.random.default_rng([_STREAM, seed, round(2 * lod)])) for lod in self.lods]

    def _probe(self, lod: float, rng: np.random.Generator) -> Probe:
        problem, effort = self.problem, self.effort
        groups, sets = effort.groups, len(PAIR_SETS)
        height, width = problem.sizes[int(lod)]
        # The reference hardly varies over levels of few texels, and takes many samples there: few points, known well.
        # What chance is in are the pairs.
        points = max(1, min(effort.points, math.isqrt(height * width)))
        samples = effort.samples * max(1, effort.points // points)
        if lod < _FINE:
            samples *= 2
        if max(height, width) <= _FEW:
            groups *= _MORE_GROUPS
        pooled = KINDS * max(2, math.ceil(_POOLED * groups))
        every = groups + pooled
        spread = region_points(problem, whole(problem), 0, every * points, rng)
        uv = rng.permutation(np.resize(spread, (every * points, 2))).reshape(every, points, 2)
        drawn = [draw_pairs(rng, SET_SIZE) for _ in range(groups)]
        weights = np.full((sets, every, SET_SIZE), 1 / SET_SIZE)
        for index in range(groups, every):
            pairs, weights[:, index] = draw_pool(rng, SET_SIZE, (index - groups) * KINDS // pooled)
            drawn.append(pairs)
        light, view = (np.stack([getattr(each, name) for each in drawn]) for name in ("light", "view"))
        mean, difference = _estimated_twice(problem, uv, lod, light, view, samples, rng, weights)
        for _ in range(_MOST_AGAIN):
            signal = energies(mean, weights) - difference
            if (difference[:, :groups].sum(1) < _NOISY * signal[:, :groups].sum(1)).all():
                break
            again, of_again = _estimated_twice(problem, uv, lod, light, view, samples, rng, weights)
            mean += again
            mean *= np.float32(0.5)
            # Two means of as many samples: errors that know nothing of each other.
            difference = (difference + of_again) / 4
            samples *= 2
        signal = energies(mean, weights) - difference
        lit = min(effort.lit_points, max(16 * height * width, 64))
        lit_uv = region_points(problem, whole(problem), 0, lit, rng)
        lit_uv = np.resize(lit_uv, (lit, 2))
        frame, lit_view = placed(rng, lit)
        many = effort.lit_samples * max(1, effort.lit_points // lit)
        # Pixels that are smaller than the texels of level 0 look level 0 up as well.
        seen = lod - _MAGNIFIED * rng.random(lit) if lod == 0 else lod
        shown = displayed(lit_reference(problem, room(self.lighting, frame, lit_view), lit_uv, seen, many, rng))
        return Probe(lod, groups, uv, light, view, weights, mean, difference, signal, lit_uv, frame, lit_view, shown)

    def looked_up(self, level: Image, index: int) -> Image:
        """(G * P + Q, C): a level at all points of a probe, bilinearly, those under the studio's lights last."""
        probe = self.probes[index]
        where = np.concatenate([probe.uv.reshape(-1, 2), probe.lit_uv])
        return look_up(level, where, self.problem.wrap)

    def of(self, texels: Image, index: int) -> Score:
        """The score of (G * P + Q, C) stored channels of the target at a probe, as `looked_up` has them."""
        probe, model = self.probes[index], self.problem.target
        groups, points = probe.uv.shape[:2]
        single, lit = texels[: groups * points].reshape(groups, points, -1), texels[groups * points :]
        sums = np.empty((len(PAIR_SETS), groups))
        for some in blocks(groups, probe.light.shape[1] * points):
            shaded = shade(model, single[some], probe.light[some], probe.view[some])
            shaded -= probe.mean[some]
            sums[:, some] = energies(shaded, probe.weights[:, some])
        log = np.log(relative(sums[:, : probe.groups] - probe.noise[:, : probe.groups], probe))
        apart = displayed(lit_radiance(model, lit, probe.frame, probe.lit_view, self.lighting)) - probe.displayed
        error = lit_error(apart, probe.displayed, probe.frame, probe.lit_view)
        return Score(log, pooled_rows(sums - probe.noise, probe), float(np.abs(apart).mean()), error.logarithm)


def _estimated_twice(
    problem: Problem,
    uv: Array,
    lod: float,
    light: Image,
    view: Image,
    samples: int,
    rng: np.random.Generator,
    weights: Array,
) -> tuple[Image, Array]:
    """The mean of two estimates of the reference (G, K, P, 3), and the energy (S, G) of its noise."""
    where, lighting = Pixels(uv, lod), GroupPairs(light, view)
    first, second = (estimate(problem.filtered, where, lighting, samples, rng) for _ in range(2))
    noise = energies((first - second) / np.float32(2), weights)
    first += second
    return np.multiply(first, np.float32(0.5), out=first), noise


def blocks(groups: int, renders: int) -> list[slice]:
    """Groups whose renders, so many each, are worked on at a time."""
    step = max(1, _RADIANCES // renders)
    return [slice(start, start + step) for start in range(0, groups, step)]


def energies(radiance: Image, weights: Array) -> Array:
    """(S, G) weighted means of squares, of (G, S * 64, P, 3) under weights (S, G, 64)."""
    rows = radiance.reshape(*radiance.shape[:2], -1)
    squares = np.einsum("gkx,gkx->gk", rows, rows).reshape(len(rows), len(weights), -1)
    return np.asarray(np.einsum("sgk,gsk->sg", weights, squares) / rows.shape[2])


def relative(error: Array, probe: Probe) -> Array:
    """(S, G) errors of the groups of pair sets in units of their signal; 1 where nothing is lit."""
    noise, signal = probe.noise[:, : probe.groups], probe.signal[:, : probe.groups]
    ratio = np.maximum(error, 2 * _RESOLVED * noise) / np.maximum(signal, 1e-30)
    return np.where(signal > UNLIT, np.maximum(ratio, FLOOR), 1.0)


def pooled_rows(error: Array, probe: Probe) -> Array:
    """(2 S, H) pseudo-values of the logarithms of the pooled errors, of (S, G) errors of all groups."""

    def log(parts: Array) -> Array:
        """Logarithms from sums over groups: error, noise and signal (3, ...)."""
        ratio = np.maximum(parts[0], 2 * _RESOLVED * parts[1]) / np.maximum(parts[2], 1e-30)
        return np.where(parts[2] > UNLIT, np.log(np.maximum(ratio, FLOOR)), 0.0)

    ours = np.stack([each[:, probe.groups :] for each in (error, probe.noise, probe.signal)])
    parts = np.concatenate(np.split(ours, KINDS, -1), 1)  # (3, 2 S, H)
    total, count = parts.sum(-1), parts.shape[-1]
    return np.asarray(count * log(total)[:, None] - (count - 1) * log(total[..., None] - parts))


def spoken_snr(snr: Array) -> str:
    """`near-mirror 21.3 dB, hemisphere 24.1 dB`."""
    return ", ".join(f"{name} {value:.1f} dB" for name, value in zip(PAIR_SETS, snr, strict=True))
