"""Pixels with light-view pairs of their own and low-noise estimates of the reference: what texels are fitted to.

A texel has a handful of parameters, and what is measured of it hangs on few pairs: those that hit its lobe. So pixels
of fine levels have pairs of their own, drawn where they count: one part like each pair set, the others with half
vectors from lobes around the pixel's normal. Each carries its importance weight for each pair set (the balance
heuristic of Veach and Guibas 1995): one set of renders stands for all pair sets without bias. Pixels of coarse levels
cover all kinds of lobes; theirs are common pairs, whose errors are known one by one (pair_weights.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.rules import RULES
from mipbake.material import MODELS, Kind
from mipbake.quality.metrics.pairs import NEAR_MIRROR_SPREAD, LightViewPairs
from mipbake.quality.reference import lobes as around
from mipbake.quality.reference.estimate import estimate
from mipbake.quality.reference.lighting import PixelPairs
from mipbake.quality.reference.problem import Image, Problem, covered
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.samplers import frames_at

_RENDERS = 1 << 17  # pixels times pairs drawn at a time: what is computed from them stays near
_MOST_SAMPLES = 128  # of a pixel
_SHIFTS, _DIMENSIONS = 7919, 6  # of the sequences that pairs of pixels follow; the first is a seed
_GOLDEN = 1.1127756842787055  # the root of x^7 = x + 1: the additive recurrence in six dimensions (Roberts 2018)
_STEPS = _GOLDEN ** -np.arange(1.0, _DIMENSIONS + 1)

PLAIN = MODELS["gltf"]
"""The model of materials that only steer the search: where half vectors are drawn, and how bright a pair is about. It
is not the target on purpose. Every source can be written in it, its lobe is round, and so one number is its width."""


@dataclass(frozen=True)
class Chunk:
    """P pixels that look up the same two levels, with K light-view pairs each.

    Args:
        level: that the pixels belong to: the levels of detail of their lookups are within 1/2 of it.
        lower: the finer of the two levels that they look up.
        share: (P frames,) of the coarser one, lower + 1, in each lookup; None where all are 0.
        uv: (P frames, 2) of all lookups, the frames of a pixel side by side. where: the pixels.
        light, view: (K, P, 3).
        importance: (S, K, P) of each pair in the mean over pairs drawn like each of S pair sets; None for common pairs.
        common: (K, P) which of the common pairs these are; None for pairs of the pixel's own.
        pixels: of its level, in all chunks of a round; every level counts the same.
        frames: whose mean is shown.
    """

    level: int
    lower: int
    share: NDArray[np.float32] | None
    uv: NDArray[np.float64]
    where: Pixels
    light: Image
    view: Image
    importance: Image | None
    common: NDArray[np.int64] | None
    pixels: int = 1
    frames: int = 1

    @property
    def lods(self) -> NDArray[np.float64]:
        """(P,) levels of detail of lookups."""
        share = np.zeros(len(self.uv)) if self.share is None else self.share.astype(float)
        return np.asarray(self.lower + share[:: self.frames])

    @property
    def seen(self) -> list[tuple[int, NDArray[np.float32] | None]]:
        """The levels that are looked up, and (P,) the share of each; None for all of it."""
        return levels_seen(self.lower, self.share)


@dataclass(frozen=True)
class Lobes:
    """What half vectors are drawn from: the lobes of a stack, a little wider.

    Args:
        levels: (H_L, W_L, C) stored channels of PLAIN.
    """

    levels: Sequence[Image]

    @classmethod
    def under(cls, problem: Problem) -> list[Lobes]:
        """Lobes that cover the lobes under a texel: the lobe of the mean material, and a wide lobe of all."""
        args = problem.stored, problem.source, PLAIN.name, problem.pixel_filter, problem.wrap, lambda _: None
        return [cls(RULES[name](*args).levels) for name in ("linear", "lean")]

    def at(self, level: int, uv: NDArray[np.float64]) -> Image:
        """(P, 4) unit normal and alpha of the texel that contains each of (P, 2) uv."""
        texels = self.levels[level]
        height, width = texels.shape[:2]
        rows = np.clip((uv[:, 1] % 1 * height).astype(np.int64), 0, height - 1)
        columns = np.clip((uv[:, 0] % 1 * width).astype(np.int64), 0, width - 1)
        stored = texels[rows, columns]
        (roughness,) = PLAIN.of(Kind.ROUGHNESS)
        alpha = np.clip(around.WIDER * np.square(stored[:, roughness]), around.LEAST_ALPHA, 1)
        return np.concatenate([stored[:, PLAIN.normal], alpha], -1)


def own_pairs(
    problem: Problem,
    lobes: Sequence[Lobes],
    level: int,
    uv: NDArray[np.float64],
    count: int,
    turn: int,
    rng: np.random.Generator,
) -> Iterator[Chunk]:
    """Chunks of pixels (P, 2) of a level, neighbours side by side, with `count` pairs of their own each.

    Pixels in the same places of `uv` continue their sequences of pairs from turn to turn: together they are spread
    more evenly than chance has it, which for smooth lobes is worth several times as many.
    """
    shifts = np.random.default_rng([_SHIFTS, level]).random((_DIMENSIONS, len(uv)), np.float32)
    for place, lods, lower in chunked(problem, level, len(uv), count, rng):
        lobe = [each.at(level, uv[place]) for each in lobes]
        light, view, importance = _draw(lobe, count, turn, shifts[:, place])
        yield _chunk(problem, level, lower, lods, uv[place], (light, view, importance, None), rng)


def common_pairs(
    problem: Problem, pairs: LightViewPairs, level: int, uv: NDArray[np.float64], count: int, rng: np.random.Generator
) -> Iterator[Chunk]:
    """Chunks of pixels (P, 2) of a level with `count` of the common pairs each, half of them of each pair set.

    All pairs have their turn before any comes again.
    """
    light, view = pairs.light, pairs.view
    each, half = len(light) // 2, count // 2
    order = np.stack([rng.permutation(each), each + rng.permutation(each)])
    for place, lods, lower in chunked(problem, level, len(uv), count, rng):
        turns = (place * half + np.arange(half)[:, None]) % each
        index = order[:, turns].reshape(count, -1)
        yield _chunk(problem, level, lower, lods, uv[place], (light[index], view[index], None, index), rng)


def _chunk(
    problem: Problem,
    level: int,
    lower: int,
    lods: NDArray[np.float64],
    uv: NDArray[np.float64],
    pairs: tuple[Image, Image, Image | None, NDArray[np.int64] | None],
    rng: np.random.Generator,
) -> Chunk:
    """Pixels (P, 2), whose lookups have (P,) levels of detail, with light, view, importance and common pairs."""
    frames, share = problem.sampler.frames, share_of(lods, lower)
    stated = lower + (np.zeros(len(lods)) if share is None else share.astype(float))
    size = covered(problem, stated, rng)
    at = frames_at(uv, problem.square_pixels(size), frames)
    every = None if share is None else np.repeat(share, frames)
    return Chunk(level, lower, every, at, Pixels(uv, size), *pairs, frames=frames)


def chunked(
    problem: Problem, level: int, pixels: int, count: int, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64], int]]:
    """Indices of pixels, their levels of detail, and the finer of the two levels that they look up."""
    step = max(1, _RENDERS // count)
    for start in range(0, pixels, step):
        some = np.arange(start, min(pixels, start + step))
        lods = np.clip(level + rng.random(len(some)) - 0.5, 0, problem.last)
        for lower in (level - 1, level):
            inside = (lods < level) if lower < level else (lods >= level)
            if inside.any():
                yield some[inside], lods[inside], lower


def levels_seen(lower: int, share: NDArray[np.float32] | None) -> list[tuple[int, NDArray[np.float32] | None]]:
    """The levels that pixels look up, and (P,) the share of each; None for all of it."""
    return [(lower, None)] if share is None else [(lower, 1 - share), (lower + 1, share)]


def share_of(lods: NDArray[np.float64], lower: int) -> NDArray[np.float32] | None:
    """(P,) share of the coarser of two levels in lookups; None where all are 0."""
    return (lods - lower).astype(np.float32) if (lods > lower).any() else None


def _draw(lobes: Sequence[Image], pairs: int, turn: int, shifts: Image) -> tuple[Image, Image, Image]:
    """Light and view (K, P, 3) for M lobes (P, 4) of each pixel, and (S, K, P) importance weights.

    Views are cosine-distributed in every pair set and here; given the view, lights are drawn from a mixture, the same
    number from each density: the densities of the pair sets, and half vectors distributed like each lobe. A pair weighs
    p / q / K in the mean over pairs of density p, where q is the mixture's density.
    """
    part = pairs // (2 + len(lobes))
    steps = _fraction((np.arange(pairs) % part + turn * part) * _STEPS[:, None]).astype(np.float32)[..., None]

    def uniform(axis: int, kind: int) -> Image:
        return _fraction(steps[axis, kind * part : (kind + 1) * part] + shifts[axis])

    view = _cosine(_fraction(steps[0] + shifts[0]), _fraction(steps[1] + shifts[1]))
    spread = np.float32(NEAR_MIRROR_SPREAD)
    mirror = view[:part] * np.array([-1, -1, 1], np.float32)
    # Box and Muller 1958: two normal numbers are made from two uniform numbers; the fourth is not needed.
    radii = [np.sqrt(-2 * np.log(np.maximum(1 - uniform(axis, 0), 1e-7))) for axis in (2, 4)]
    angles = [uniform(axis, 0) * (2 * math.pi) for axis in (3, 5)]
    noise = [radii[0] * np.cos(angles[0]), radii[0] * np.sin(angles[0]), radii[1] * np.cos(angles[1])]
    lights = [around.unit(mirror + spread * np.stack(noise, -1)), _cosine(uniform(2, 1), uniform(3, 1))]
    for kind, lobe in enumerate(lobes, 2):
        seen = view[kind * part : (kind + 1) * part]
        lights.append(around.reflected(seen, around.half_vectors(lobe, uniform(2, kind), uniform(3, kind))))
    light = np.concatenate(lights)

    near, hemisphere = around.around_mirror_density(light, view), around.hemisphere_density(light)
    density = near + hemisphere
    for lobe in lobes:
        density += around.lobe_density(lobe, light, view)
    scale = (light[..., 2] > 0) / np.maximum(density * np.float32(part), 1e-12)
    return light, view, np.stack([around.near_mirror_density(light, view) * scale, hemisphere * scale])


def _fraction(x: NDArray[np.floating]) -> NDArray[Any]:
    """What numbers that are not negative have behind the point, in their dtype."""
    return np.asarray(x - np.floor(x))


def _cosine(u: Image, v: Image) -> Image:
    """(..., 3) cosine-distributed directions, of uniform numbers (...)."""
    radius, angle = np.sqrt(u), v * (2 * math.pi)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(np.maximum(1 - u, 1e-8))], -1)


def samples_at(level: int, samples: int) -> int:
    """Reference samples of a pixel of a level, where a pixel of level 0 has `samples`."""
    return max(samples, min(samples << (level + 1) // 2, _MOST_SAMPLES))


def estimates(problem: Problem, chunk: Chunk, samples: int, rng: np.random.Generator) -> Image:
    """(K, P, 3) estimates of the reference, `samples` of each pixel of level 0, twice as many at every second level."""
    samples = samples_at(chunk.level, samples)
    lighting = PixelPairs(chunk.light, chunk.view)
    return np.asarray(estimate(problem.filtered, chunk.where, lighting, samples, rng)[0])


def in_every_frame(pairs: Image, frames: int) -> Image:
    """(K, P frames, 3) directions of every frame's lookup, of (K, P, 3) directions."""
    return pairs if frames == 1 else np.repeat(pairs, frames, 1)
