"""A level as a blend of ingredients, its few weights fitted to renders by Gauss-Newton.

Methods differ in how rough they make a level, how much they straighten its normals and what they take its colours to
be, and each of these may be right where the others are wrong. So every map of a level is a blend of its own:
base + sum_k theta_k (ingredient_k - base), with one theta for each map and ingredient, negative or above 1 where that
fits. A level has some twenty numbers to fit to a million renders: unlike free texels, they do not follow noise.

What is minimised is the sum of logarithms of the errors, as figures are quoted (scores.py): of every group of pairs,
of both pair sets, of the brightest pairs by themselves, and of the tonemapped renders under a studio's lights. What is
behind the best closed form counts several times, so that no gain in one is paid for by a loss in another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.judging.bright_pairs import KINDS
from mipbake.judging.held_out import SET_SIZE
from mipbake.judging.lit_renders import EXPOSURE, display_slope, displayed, lit_error, lit_radiance
from mipbake.judging.scores import (
    UNLIT,
    Array,
    Probe,
    Score,
    blocks,
    energies,
    pooled_rows,
    relative,
)
from mipbake.judging.weights import FIT, LIT
from mipbake.material import MODELS
from mipbake.metrics.pairs import PAIR_SETS
from mipbake.reference.problem import Image
from mipbake.render.environment import Lighting
from mipbake.shading import shade
from mipbake.shading.adjoint import shade_adjoint

_SETS = len(PAIR_SETS)
_ITERATIONS, _ENOUGH = 10, 4e-3
_STRIDE = 8  # one in so many pairs takes part in curvature
_DAMPING, _TRIES = 1e-3, 4
_RIDGE, _RANGE = 0.3, (-0.5, 1.5)  # holds weights, which run off where ingredients all but agree


@dataclass(frozen=True)
class Term:
    """A level of detail that sees the level.

    Args:
        probe: where.
        asked: what the best closed form has there.
        share: of the level in the lookup. other: (N, C) what the rest of the lookup is; None where share is 1.
        base: (N, C) looked-up texels where all weights are 0. columns: (J, N, C) what weights add.
    """

    probe: Probe
    asked: Score
    share: float
    other: Image | None
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


def fit_level(terms: Sequence[Term], model: str, lighting: Lighting) -> NDArray[np.float32]:
    """(J,) weights of the columns of a level."""
    seen = [_Term(term, model, lighting) for term in terms]
    theta = np.zeros(len(terms[0].columns))
    if not theta.size:
        return theta.astype(np.float32)
    # From the best of the ingredients.
    count = len(MODELS[model].maps)
    starts = [theta, *np.tile(np.eye(len(theta) // count), count)]
    values = [_value(seen, each) for each in starts]
    value, start = min(values), starts[int(np.argmin(values))]
    theta, damping = start, _DAMPING
    for iteration in range(_ITERATIONS):
        equations = [term.equations(theta, iteration) for term in seen]
        slope, curvature = (np.sum(parts, 0) for parts in zip(*equations, strict=True))
        slope, curvature = slope + 2 * _RIDGE * (theta - start), curvature + 2 * _RIDGE * np.eye(len(theta))
        diagonal = curvature.diagonal()
        before = value
        for _ in range(_TRIES):
            step = np.linalg.solve(curvature + np.diag(damping * diagonal), slope)
            tried = np.clip(theta - step, *_RANGE)
            value = _value(seen, tried) + _RIDGE * float(np.square(tried - start).sum())
            if value < before:
                theta = tried
                damping = max(_DAMPING, damping / 5)
                break
            damping *= 10
        else:
            break
        if before - value < _ENOUGH:
            break
    return np.asarray(theta, np.float32)


def _value(seen: Sequence[_Term], theta: Array) -> float:
    return sum(term.value(theta) for term in seen)


class _Term:
    """A Term, with what is worked out once."""

    def __init__(self, term: Term, model: str, lighting: Lighting) -> None:
        self._model, self._term, self._lighting, self._probe = model, term, lighting, term.probe
        self._groups, self._points = term.probe.uv.shape[:2]
        self._single = self._groups * self._points
        self._columns = np.ascontiguousarray(np.moveaxis(term.columns, 0, -1))  # (N, C, J)
        turn = term.probe.frame
        self._lit_light = np.ascontiguousarray(
            np.einsum("nij,kj->kni", turn, lighting.direction.astype(np.float32), optimize=True)
        )[None]
        self._lit_view = np.einsum("nij,nj->ni", turn, term.probe.lit_view)[None, None]
        self._power = (EXPOSURE * lighting.radiance).astype(np.float32)[:, None]
        self._asked = term.asked.terms
        self._sure = term.asked.trust
        self._plain = np.inf if term.asked.plain is None else term.asked.plain

    def value(self, theta: Array) -> float:
        """What is minimised, in nepers."""
        texels, probe = self._texels(theta), self._probe
        single = self._split(texels)
        sums = np.empty((_SETS, self._groups))
        for some in self._blocks():
            sums[:, some] = energies(self._off(single, some), probe.weights[:, some])
        log = self._logs(sums)
        groups = float(np.maximum(self._groups_logs(sums) - self._plain, 0).mean(1).sum())
        shown = displayed(
            lit_radiance(self._model, texels[self._single :], probe.frame, probe.lit_view, self._lighting)
        )
        lit = lit_error(shown - probe.displayed, probe.displayed, probe.frame, probe.lit_view).logarithm
        terms = np.append(log, lit)
        return FIT.value(terms, terms - self._asked, self._sure, groups)

    def equations(self, theta: Array, turn: int) -> tuple[Array, Array]:
        """(J,) slope of the value by the weights, and (J, J) its Gauss-Newton curvature."""
        texels, probe = self._texels(theta), self._probe
        single = self._split(texels)
        sums = np.empty((_SETS, self._groups))
        by_set = np.empty((_SETS, *single.shape), np.float32)
        # What a set counts is known when all groups are: until then each has a gradient of its own.
        for some in self._blocks():
            off = self._off(single, some)
            sums[:, some] = energies(off, probe.weights[:, some])
            for kind in range(_SETS):
                part = slice(kind * SET_SIZE, (kind + 1) * SET_SIZE)
                weight = probe.weights[kind, some, :, None, None].astype(np.float32)
                directions = probe.light[some, part], probe.view[some, part]
                by_set[kind, some] = shade_adjoint(self._model, single[some], *directions, off[:, part] * weight)
        counts, behind = self._sure[:-1] * FIT.counts[:-1], self._sure[:-1] * FIT.behind[:-1]
        urgent = counts + behind * (self._logs(sums) > self._asked[:-1])
        weight = self._weights(sums, urgent).astype(np.float32)  # (S, G)
        gradient = np.empty_like(texels)
        gradient[: self._single] = (2 * by_set * weight[..., None, None]).sum(0).reshape(self._single, -1)

        lit = texels[self._single :]
        radiance = lit_radiance(self._model, lit, probe.frame, probe.lit_view, self._lighting)
        slopes = display_slope(radiance)
        lit_off = displayed(radiance) - probe.displayed
        error = lit_error(lit_off, probe.displayed, probe.frame, probe.lit_view)
        of_lit = FIT.terms[LIT]
        counts = of_lit.counts + of_lit.behind * (error.logarithm > self._asked[-1])
        gradient[self._single :] = self._lit_adjoint(lit, np.float32(counts) * error.slopes(lit_off) * slopes)

        share = self._term.share
        slope = share * (gradient.reshape(-1) @ self._columns.reshape(gradient.size, -1))
        rows = self._rows(single, 2 * np.concatenate(list(weight[..., None] * probe.weights), 1), turn)
        signs = _signs(slopes.shape, 0) * slopes * np.float32(np.sqrt(counts * error.pixel_weight / slopes.size))
        along = np.concatenate([rows, self._lit_rows(lit, signs)])
        curvature = along.T @ along + counts * error.curvature(self._lit_rows(lit, slopes))
        return slope.astype(np.float64), (share * share * curvature).astype(np.float64)

    def _texels(self, theta: Array) -> Image:
        base = self._term.base
        added = self._columns.reshape(base.size, -1) @ theta.astype(np.float32)
        own = material.regularise(base + added.reshape(base.shape), self._model)
        if self._term.other is None:
            return own
        share = np.float32(self._term.share)
        return np.asarray(share * own + (1 - share) * self._term.other, np.float32)

    def _split(self, texels: Image) -> Image:
        return texels[: self._single].reshape(self._groups, self._points, -1)

    def _blocks(self) -> list[slice]:
        return blocks(self._groups, self._probe.light.shape[1] * self._points)

    def _off(self, single: Image, some: slice) -> Image:
        """(g, K, P, 3): what some groups are off by."""
        shaded = shade(self._model, single[some], self._probe.light[some], self._probe.view[some])
        shaded -= self._probe.mean[some]
        return np.asarray(shaded)

    def _logs(self, sums: Array) -> Array:
        """(3 S,) as Score.means has them, of (S, G) energies of the error and the noise of the reference."""
        error = sums - self._probe.noise
        return np.append(self._groups_logs(sums).mean(1), pooled_rows(error, self._probe).mean(1))

    def _groups_logs(self, sums: Array) -> Array:
        """(S, G) as Score.log_errors has them."""
        own = self._probe.groups
        return np.asarray(np.log(relative((sums - self._probe.noise)[:, :own], self._probe)))

    def _weights(self, sums: Array, urgent: Array) -> Array:
        """(S, G): derivatives of what is minimised by the mean squares of the groups, over 3 P."""
        probe, own = self._probe, self._probe.groups
        error = sums - probe.noise
        out = np.empty_like(sums)
        signal = probe.signal[:, :own]
        at_least = relative(error[:, :own], probe) * signal
        # Unlit pairs have no figure, so nothing to gain either.
        each = urgent[:_SETS, None] + FIT.group_behind * (self._groups_logs(sums) > self._plain)
        out[:, :own] = np.where(signal > UNLIT, each / np.maximum(at_least * own, 1e-20), 0.0)
        parts = np.split(probe.signal[:, own:], KINDS, -1)
        total = np.concatenate([part.sum(1) for part in parts])
        pooled = np.exp(pooled_rows(error, probe).mean(1)) * total
        each = np.where(total > UNLIT, urgent[_SETS:] / np.maximum(pooled, 1e-20), 0.0).reshape(KINDS, _SETS)
        out[:, own:] = np.repeat(each.T, parts[0].shape[1], 1)
        return np.asarray(out / (3 * self._points))

    def _lit_adjoint(self, lit: Image, gradient: Image) -> Image:
        """(Q, C) gradients by texels, from (Q, 3) ones by their radiance under all lights."""
        light = self._lit_light
        view = np.broadcast_to(self._lit_view, light.shape)
        return np.asarray(shade_adjoint(self._model, lit[None], light, view, (self._power * gradient)[None])[0])

    def _lit_rows(self, lit: Image, gradient: Image) -> Image:
        """(Q, J) derivatives by the weights, from (Q, 3) ones by the radiance under all lights."""
        return np.asarray(np.matmul(self._lit_adjoint(lit, gradient)[:, None], self._columns[self._single :])[:, 0])

    def _rows(self, single: Image, weight: Image, turn: int) -> Image:
        """(M, J): derivatives by the weights of every _STRIDE-th render, random combinations of its colours.

        Their squares sum to the curvature of all renders, each of which counts `weight` (G, K).
        """
        probe, some = self._probe, slice(turn % _STRIDE, None, _STRIDE)
        pairs = probe.light[:, some].shape[1]
        texels = np.repeat(single, pairs, 0)
        signs = _signs((len(texels), 1, self._points, 3), turn)
        signs *= np.sqrt(_STRIDE * weight[:, some]).reshape(-1, 1, 1, 1).astype(np.float32)
        light, view = (d[:, some].reshape(-1, 1, 3) for d in (probe.light, probe.view))
        rows = shade_adjoint(self._model, texels, light, view, signs).reshape(self._groups, pairs, self._points, -1)
        rows = rows.transpose(0, 2, 1, 3).reshape(self._single, pairs, -1)
        return np.asarray(np.matmul(rows, self._columns[: self._single]).reshape(self._single * pairs, -1))


def _signs(shape: tuple[int, ...], seed: int) -> Image:
    return np.asarray(2 * np.random.default_rng(seed).integers(0, 2, shape, np.int8) - 1, np.float32)
