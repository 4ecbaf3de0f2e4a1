"""Scores of candidates against the reference, at many points under many pairs, from looked-up texels alone.

The SNR of a set of pairs varies by decibels from set to set, and on glossy sets from points to points. So each level of
detail is measured in groups: a group is what a figure is quoted for, 64 pairs of each pair set, at points of its own.
Means over groups average both kinds of chance, and their scatter says what is left of it.

Candidates are looked up once at all points. A level that blends candidates blends what was looked up, since lookups are
linear in stored channels, so blends cost a shading each and no images.

SNR under single lights follows the brightest pairs. What people look at is lit from everywhere and tonemapped: dim
renders and casts of colour count there. So every level of detail is also measured under a studio's lights, on surfaces
turned every way to the viewer, by the tonemapped error (mipbake.metrics.tonemapped).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.metrics.images import srgb_encode
from mipbake.metrics.pairs import PAIR_SETS, cosine_directions
from mipbake.prefilter.held_out import (
    QUANTILES,
    SEQUENCE,
    SET_SIZE,
    Image,
    Problem,
    draw_pairs,
    quantiles,
    random_points,
    whole,
)
from mipbake.render.environment import Lighting, studio
from mipbake.shading import shade, shade_lit

Array = NDArray[np.float64]

_STREAM = 15485863  # keeps these pairs apart from every set that pair_set draws
DECIBEL = 10 / math.log(10)
FLOOR = 1e-7  # error in units of the signal that is as good as none
_RESOLVED = 0.01  # share of the reference's noise energy below which an error is chance (metrics.snr)
_FEW, _MORE_GROUPS = 32, 3  # texels a side up to which there are so many times the groups, of fewer points
_RADIANCES = 1 << 18  # at a time
EXPOSURE = 1.5  # a white matte sphere's radiance under the studio's lights, as in compare's views


@dataclass(frozen=True)
class Effort:
    """How much is rendered at each level of detail.

    Args:
        groups: of pairs; levels of few texels have more. points: in each, at most.
        samples: of the reference at each point, twice.
        lit_points, lit_samples: under the studio's lights.
    """

    groups: int = 24
    points: int = 192
    samples: int = 16
    lit_points: int = 1024
    lit_samples: int = 16


@dataclass(frozen=True, eq=False)
class Score:
    """What a stack is off by at a level of detail.

    Args:
        log_errors: (S, G) natural logarithms of the error relative to the signal, of S pair sets and G groups.
        lit: tonemapped error under the studio's lights. lit_square: logarithm of the mean of its squares.
    """

    log_errors: Array
    lit: float
    lit_square: float

    @property
    def decibels(self) -> Array:
        """(S,) SNR, the mean over groups."""
        return np.asarray(-DECIBEL * self.log_errors.mean(1))


@dataclass(frozen=True, eq=False)
class Probe:
    """One level of detail: where it is measured, and what is right there.

    Args:
        lod: level of detail; `levels` that a lookup reads, one or two.
        uv: (G, P, 2). light, view: (G, S * 64, 3).
        mean: (G, K, P, 3) mean of two estimates of the reference. noise: (S, G) what their difference says of it.
        signal: (S, G).
    """

    lod: float
    uv: Array
    light: Image
    view: Image
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
        # Levels of few texels need few points, and more samples: the reference hardly varies over them, and pairs are
        # what chance is in.
        points = max(1, min(effort.points, max(4 * height * width, 16)))
        samples = effort.samples * max(1, effort.points // points)
        if max(height, width) <= _FEW:
            groups, points, samples = _MORE_GROUPS * groups, max(1, points // _MORE_GROUPS), 2 * samples
        spread = random_points(problem, whole(problem), 0, groups * points, rng)
        uv = rng.permutation(np.resize(spread, (groups * points, 2))).reshape(groups, points, 2)
        pairs = [draw_pairs(rng, SET_SIZE) for _ in range(groups)]
        light, view = (np.stack([getattr(each, name) for each in pairs]) for name in ("light", "view"))
        first, second = (_estimates(problem, uv, lod, light, view, samples, rng) for _ in range(2))
        mean = (first + second) / np.float32(2)
        half = (first - second) / np.float32(2)
        difference = _squares(half, sets)
        signal = _squares(mean, sets) - difference
        lit = min(effort.lit_points, max(16 * height * width, 64))
        lit_uv = random_points(problem, whole(problem), 0, lit, rng)
        lit_uv = np.resize(lit_uv, (lit, 2))
        frame, lit_view = placed(rng, lit)
        many = effort.lit_samples * max(1, effort.lit_points // lit)
        shown = displayed(lit_reference(problem, self.lighting, lit_uv, lod, frame, lit_view, many, rng))
        return Probe(lod, uv, light, view, mean, difference, signal, lit_uv, frame, lit_view, shown)

    def looked_up(self, level: Image, index: int) -> Image:
        """(G * P + Q, C): a level at all points of a probe, bilinearly, those under the studio's lights last."""
        probe = self.probes[index]
        where = np.concatenate([probe.uv.reshape(-1, 2), probe.lit_uv])
        return _look_up(level, where, self.problem)

    def of(self, texels: Image, index: int) -> Score:
        """The score of (G * P + Q, C) stored channels of the target at a probe, as `looked_up` has them."""
        probe, model = self.probes[index], self.problem.target
        groups, points = probe.uv.shape[:2]
        single, lit = texels[: groups * points], texels[groups * points :]
        shaded = shade(model, single.reshape(groups, points, -1), probe.light, probe.view)
        shaded -= probe.mean
        error = _squares(shaded, len(PAIR_SETS)) - probe.noise
        ratio = np.maximum(error, 2 * _RESOLVED * probe.noise) / np.maximum(probe.signal, 1e-30)
        log = np.where(probe.signal > 0, np.log(np.maximum(ratio, FLOOR)), 0.0)
        apart = displayed(_lit(model, lit, probe.frame, probe.lit_view, self.lighting)) - probe.displayed
        square = max(float(np.square(apart).mean()), FLOOR)
        return Score(log, float(np.abs(apart).mean()), math.log(square))


def _look_up(level: Image, uv: Array, problem: Problem) -> Image:
    return np.asarray(
        sampling.texture(level[None], uv[None, None], filter_mode="linear", boundary_mode=problem.wrap)[0, 0]
    )


def offsets(
    problem: Problem, shape: tuple[int, ...], lod: float | Array, rng: np.random.Generator
) -> tuple[Array, NDArray[np.float32]]:
    """(S, ..., 2) offsets of samples from their pixel's centre, and (S, ...) weights whose sum over S is about 1.

    lod: level of detail of all pixels, or (..., 1) of each.
    """
    offsets, weights = quantiles(problem.pixel_filter)
    height, width = problem.stored.shape[:2]
    sequence = np.arange(shape[0]).reshape(-1, *(1,) * len(shape)) * SEQUENCE % 1 * QUANTILES
    place = (rng.integers(QUANTILES, size=(*shape[1:], 2)) + sequence.astype(np.int64)) & (QUANTILES - 1)
    return offsets[place] * (2.0**lod / np.array([width, height])), weights[place].prod(-1) / np.float32(shape[0])


def _estimates(
    problem: Problem, uv: Array, lod: float, light: Image, view: Image, samples: int, rng: np.random.Generator
) -> Image:
    """(G, K, P, 3): the reference at points of groups under the pairs of each group."""
    groups, points = uv.shape[:2]
    pairs = light.shape[1]
    out = np.empty((groups, pairs, points, 3), np.float32)
    chunk = max(1, _RADIANCES // (pairs * samples))

    def shaded(where: Array, group: int) -> Image:
        texels = _look_up(problem.stored, where.reshape(-1, 2), problem)
        return shade(problem.source, texels, light[group], view[group])

    for group in range(groups):
        for start in range(0, points, chunk):
            centres = uv[group, start : start + chunk]
            offset, weight = offsets(problem, (samples, len(centres)), lod, rng)
            radiance = shaded(centres + offset, group).reshape(pairs, samples, -1)
            if (weight < 0).any():
                rest = (1 - weight.sum(0))[:, None] * shaded(centres, group)
                seen = (radiance.reshape(pairs, samples, -1, 3) * weight[..., None]).sum(1) + rest
            else:
                seen = (np.full((1, samples), 1 / samples, np.float32) @ radiance).reshape(pairs, -1, 3)
            out[group, :, start : start + chunk] = seen
    return out


def lit_reference(
    problem: Problem,
    lighting: Lighting,
    uv: Array,
    lod: float | Array,
    frame: Image,
    view: Image,
    samples: int,
    rng: np.random.Generator,
) -> Image:
    """(P, 3) reference under all lights at (P, 2) uv, each pixel with a frame and a view of its own.

    lod: level of detail of all pixels, or (P, 1) of each.
    """

    def shaded(where: Array, turns: int) -> Image:
        texels = _look_up(problem.stored, where.reshape(-1, 2), problem)
        return _lit(problem.source, texels, np.tile(frame, (turns, 1, 1)), np.tile(view, (turns, 1)), lighting)

    offset, weight = offsets(problem, (samples, len(uv)), lod, rng)
    radiance = shaded(uv + offset, samples).reshape(samples, len(uv), 3)
    if (weight < 0).any():
        return np.asarray((radiance * weight[..., None]).sum(0) + (1 - weight.sum(0))[:, None] * shaded(uv, 1))
    return np.asarray(radiance.mean(0))


def _lit(model: str, texels: Image, frame: Image, view: Image, lighting: Lighting) -> Image:
    return np.asarray(shade_lit(model, texels, frame, view, lighting.direction, lighting.radiance * EXPOSURE))


def _squares(radiance: Image, sets: int) -> Array:
    """(S, G) means of squares over the points and pairs of each set, of (G, S * 64, P, 3)."""
    rows = radiance.reshape(len(radiance) * sets, 1, -1)
    sums = np.asarray((rows @ rows.swapaxes(1, 2))[:, 0, 0], np.float64)
    return np.asarray(sums.reshape(len(radiance), sets).T / rows.shape[2])


def placed(rng: np.random.Generator, count: int) -> tuple[Image, Image]:
    """(N, 3, 3) tangent frames in a room and (N, 3) views from it: spheres seen from about their own height."""
    angle = 2 * math.pi * rng.random(count)
    height = rng.uniform(-0.2, 0.6, count)
    flat = np.sqrt(1 - height * height)
    view = np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], -1)
    local = cosine_directions(rng, count)  # where on the sphere's disc: normals are cosine-distributed around the view
    side = np.stack([-view[:, 2], np.zeros(count), view[:, 0]], -1)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(side, view)
    normal = local[:, :1] * side + local[:, 1:2] * up + local[:, 2:] * view
    tangent = np.stack([normal[:, 2], np.zeros(count), -normal[:, 0]], -1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    frame = np.stack([tangent, np.cross(normal, tangent), normal], 1)
    return frame.astype(np.float32), view.astype(np.float32)


def displayed(radiance: Image) -> Image:
    """Linear radiance as a display shows it: x / (1 + x), sRGB-encoded, as mipbake.metrics.tonemapped has it."""
    lit = np.maximum(radiance, 0)
    return np.asarray(srgb_encode(lit / (1 + lit)), np.float32)
