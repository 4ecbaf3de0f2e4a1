"""A level as a blend of ingredients, its few shares fitted to renders.

Methods differ in how rough they make a level, how much they straighten its normals and what they take its colours to
be, and each of these may be right where the others are wrong. So every map of a level is a blend of its own:
base + sum_k theta_k (ingredient_k - base). theta is a share, one for each map and ingredient, negative or above 1 where
that fits. A level has some twenty shares to fit to a million renders: unlike free texels, they do not follow noise.

What is minimised is what a judge says of the level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.search.gauss_newton import System, accepted, signs
from mipbake.material import MODELS
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.pairs import SET_SIZE
from mipbake.quality.judging.probes import mean_squares
from mipbake.quality.judging.scores import Errors, Scores, blocks, off_by
from mipbake.quality.judging.terms import Array
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.metrics.visible import SENSITIVITY, bands_adjoint
from mipbake.quality.reference.problem import Image
from mipbake.quality.samplers import in_frames
from mipbake.shading.adjoint import shade_adjoint

_ITERATIONS, _ENOUGH = 3, 0.05  # most steps, and nepers gained by one that are too few to go on
_STRIDE = 8  # one in so many pairs takes part in curvature
_COMBINATIONS = 1  # of the bands of a picture in curvature
_DAMPING = 0.1  # in units of a block's own curvature
_RIDGE, _RANGE = 0.5, (-0.5, 1.5)  # holds shares, which run off where ingredients all but agree


@dataclass(frozen=True)
class SeenAt:
    """What a probe sees of a level.

    Args:
        index: of the probe.
        base: (N, C) looked-up texels where all shares are 0. columns: (J, N, C) what shares add.
    """

    index: int
    base: Image
    columns: Image


def columns(base: Image, others: Sequence[Image], model: str) -> Image:
    """(J, ..., C): differences of ingredients from the base, each map of the model by itself, ingredient by
    ingredient."""
    out = np.zeros((len(MODELS[model].maps) * len(others), *base.shape), np.float32)
    for index, channels in enumerate(MODELS[model].maps.values()):
        for k, other in enumerate(others):
            out[index * len(others) + k][..., channels] = other[..., channels] - base[..., channels]
    return out


def fit_level(seen: SeenAt, scores: Scores, judge: Judge, start: NDArray[np.floating]) -> NDArray[np.float32]:
    """(J,) shares of the columns of a level.

    Args:
        start: (J,) shares to begin with, which hold what is fitted.
    """
    error = _Error(seen, scores, judge)
    best = error.value(start)
    none = np.zeros(len(start))
    if not none.size:
        return none.astype(np.float32)
    low, high = (np.full(none.shape, end) for end in _RANGE)
    held = 2 * _RIDGE * np.eye(none.size)[None]
    begin, unit = start[None].astype(float), np.ones((1, none.size))
    here, damping = begin, _DAMPING
    for turn in range(_ITERATIONS):
        slope, curvature = error.equations(here[0], turn)
        system = System(begin, curvature[None], held, unit, (low, high), damping)
        step = accepted(system, here, slope[None], lambda tried: error.value(tried[0]), best, damping)
        if step is None:
            break
        before, (here, best, damping) = best, step
        damping = max(_DAMPING, damping)
        if before - best < _ENOUGH:
            break
    return np.asarray(here[0], np.float32)


class _Error:
    """What the judge says of a level of detail, by the shares; what is worked out once."""

    def __init__(self, seen: SeenAt, scores: Scores, judge: Judge) -> None:
        self._seen, self._scores, self._judge = seen, scores, judge
        self._model, self._probe = scores.problem.target, scores.probes[seen.index]
        self._groups, self._points = self._probe.uv.shape[:2]  # of every frame
        self._shown = self._probe.shown.pictures.points
        self._single = self._groups * self._points
        self._columns = np.ascontiguousarray(np.moveaxis(seen.columns, 0, -1))  # (N, C, J)

    def value(self, theta: NDArray[np.floating]) -> float:
        """What is minimised, in nepers."""
        return self._judge.value(self._scores.of(self._texels(theta), self._seen.index), self._seen.index)

    def equations(self, theta: NDArray[np.floating], turn: int) -> tuple[Array, Array]:
        """(J,) slope of the value by the shares, and (J, J) its Gauss-Newton curvature."""
        rng = np.random.default_rng(turn)
        texels, probe = self._texels(theta), self._probe
        single = texels[: self._single].reshape(self._groups, self._points, -1)
        pixels = texels[self._single :].reshape(-1, self._shown, texels.shape[-1])
        radiance = probe.shown.pictures.radiance(self._model, pixels)
        by_radiance, error = probe.shown.slope(radiance), probe.shown.error(radiance)
        squares, by_set = self._off(single)
        errors = Errors(probe, squares - probe.noise, error)
        slopes = self._judge.slopes(errors.score, self._seen.index)
        by_log = slopes.log_errors[:, None] / probe.groups + slopes.groups
        by_render = errors.slopes(by_log, slopes.pooled) / (3 * self._points // probe.frames)  # (S, G)

        gradient = np.empty_like(texels)
        by_texel = (2 * by_set * by_render.astype(np.float32)[..., None, None]).sum(0)
        gradient[: self._single] = by_texel.reshape(self._single, -1)
        by_shown = error.slopes(slopes.visible).reshape(by_radiance.shape)
        gradient[self._single :] = self._adjoint(pixels, by_shown * by_radiance).reshape(-1, texels.shape[-1])
        slope = gradient.reshape(-1) @ self._columns.reshape(gradient.size, -1)

        rows = self._rows(single, 2 * np.concatenate(list(by_render[..., None] * probe.weights), 1), rng, turn)
        along = np.concatenate([rows, *self._shown_rows(pixels, by_radiance, error.weights(slopes.visible), rng)])
        curvature = along.T @ along
        return slope.astype(np.float64), curvature.astype(np.float64)

    def _texels(self, theta: NDArray[np.floating]) -> Image:
        base = self._seen.base
        added = self._columns.reshape(base.size, -1) @ theta.astype(np.float32)
        return material.regularise(base + added.reshape(base.shape), self._model)

    def _off(self, single: Image) -> tuple[Array, Image]:
        """(G, K) mean squares of what (G, P, C) texels are off by, and (S, G, P, C) derivatives of half their sums over
        the pairs of each set: what a set counts is known when all groups are."""
        probe = self._probe
        squares, by_set = np.empty(probe.noise.shape), np.empty((len(PAIR_SETS), *single.shape), np.float32)
        for some in blocks(probe):
            off = off_by(probe, self._model, single, some)
            squares[some] = mean_squares(off)
            off = in_frames(off, probe.frames)
            for kind in range(len(PAIR_SETS)):
                part = slice(kind * SET_SIZE, (kind + 1) * SET_SIZE)
                weight = probe.weights[kind, some, :, None, None].astype(np.float32)
                directions = probe.light[some, part], probe.view[some, part]
                by_set[kind, some] = shade_adjoint(self._model, single[some], *directions, off[:, part] * weight)
        return squares, by_set

    def _adjoint(self, pixels: Image, gradient: Image) -> Image:
        """(N, points, C) gradients by what pixels of pictures see, from (N, PIXELS, 3) ones by their radiance."""
        return self._probe.shown.pictures.adjoint(self._model, pixels, gradient)

    def _shown_rows(
        self, pixels: Image, by_radiance: Image, weights: Image, rng: np.random.Generator
    ) -> Iterator[Image]:
        """(N, J) derivatives by the shares of random combinations of the bands of each picture, several of each.

        Their squares sum to the curvature of all bands, whose squares count `weights` (N,).
        """
        columns = self._columns[self._single :].reshape(len(pixels), -1, self._columns.shape[-1])
        for _ in range(_COMBINATIONS):
            bands = signs((len(pixels), *SENSITIVITY.shape), rng)
            bands *= np.sqrt(2 * weights / _COMBINATIONS)[:, None, None, None]
            gradient = bands_adjoint(bands).reshape(by_radiance.shape) * by_radiance
            by_pixel = self._adjoint(pixels, gradient).reshape(len(pixels), 1, -1)
            yield np.asarray(np.matmul(by_pixel, columns)[:, 0])

    def _rows(self, single: Image, weight: Array, rng: np.random.Generator, turn: int) -> Image:
        """(M, J): derivatives by the shares of every _STRIDE-th render, random combinations of its colours.

        Their squares sum to the curvature of all renders, each of which counts `weight` (G, K).
        """
        probe, some = self._probe, slice(turn % _STRIDE, None, _STRIDE)
        pairs, frames = probe.light[:, some].shape[1], probe.frames
        texels = np.repeat(single, pairs, 0)
        turned = signs((len(texels), 1, self._points // frames, 3), rng)
        turned *= np.sqrt(_STRIDE * weight[:, some]).reshape(-1, 1, 1, 1).astype(np.float32)
        light, view = (d[:, some].reshape(-1, 1, 3) for d in (probe.light, probe.view))
        turned = in_frames(turned, frames)
        rows = shade_adjoint(self._model, texels, light, view, turned).reshape(self._groups, pairs, self._points, -1)
        rows = rows.transpose(0, 2, 1, 3).reshape(self._single, pairs, -1)
        by_frame = np.matmul(rows, self._columns[: self._single])
        if frames > 1:  # of a pixel the derivatives by all frames add up
            by_frame = by_frame.reshape(-1, frames, *by_frame.shape[1:]).sum(1)
        return np.asarray(by_frame.reshape(-1, by_frame.shape[-1]))
