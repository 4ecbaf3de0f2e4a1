"""A level as a blend of candidates, the few weights of it fitted to renders by Gauss-Newton.

Methods differ in how rough they make a level, how much they straighten its normals and what they take its colours to
be, and each of these may be right where the others are wrong. So every map of a level is a blend of its own:
base + sum_k theta_k (candidate_k - base), with one theta for each map and candidate, negative or above 1 where that
fits. A level has some twenty numbers to fit to a million renders: unlike free texels, they do not follow noise.

What is minimised is the sum of logarithms of the errors, as figures are quoted (scores.py): of every group of pairs,
of both pair sets, and of the tonemapped renders under a studio's lights. What is behind the best closed form counts
several times, so that no gain in one is paid for by a loss in another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.material import MODELS
from mipbake.metrics.pairs import PAIR_SETS
from mipbake.prefilter.held_out import SET_SIZE, Image
from mipbake.prefilter.lit_samples import encoded
from mipbake.prefilter.scores import EXPOSURE, FLOOR, Probe, Score
from mipbake.render.environment import Lighting
from mipbake.shading.ops import shade

_SETS = len(PAIR_SETS)
_BEHIND = 4.0  # times that a logarithm counts in addition while it is behind what is asked for
_LIT = 0.5  # that the error under the studio's lights counts, beside each pair set
_ITERATIONS, _ENOUGH = 10, 2e-3
_UNLIT = 1e-12  # mean square radiance below which nothing is seen
_STRIDE = 4  # one in so many pairs takes part in curvature
_DAMPING, _TRIES = 1e-3, 4


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
    """(J, ..., C): differences of candidates from the base, each map of the model by itself, candidate by candidate."""
    out = np.zeros((len(MODELS[model].maps) * len(others), *base.shape), np.float32)
    for index, channels in enumerate(MODELS[model].maps.values()):
        for k, other in enumerate(others):
            out[index * len(others) + k][..., channels] = other[..., channels] - base[..., channels]
    return out


def fit_level(terms: Sequence[Term], model: str, lighting: Lighting) -> NDArray[np.float32]:
    """(J,) weights of the columns of a level."""
    seen = [_Term(term, model, lighting) for term in terms]
    theta = torch.zeros(len(terms[0].columns))
    value = _value(seen, theta)
    damping = _DAMPING
    for iteration in range(_ITERATIONS):
        slope, curvature = (sum(parts) for parts in zip(*(t.equations(theta, iteration) for t in seen), strict=True))
        assert isinstance(slope, Tensor) and isinstance(curvature, Tensor)
        diagonal = curvature.diagonal()
        least = 1e-6 * diagonal.mean() + 1e-12
        before = value
        for _ in range(_TRIES):
            step = torch.linalg.solve(curvature + torch.diag(damping * diagonal + least), slope)
            value = _value(seen, theta - step)
            if value < before:
                theta = theta - step
                damping = max(_DAMPING, damping / 5)
                break
            damping *= 10
        else:
            return theta.numpy()
        if before - value < _ENOUGH:
            break
    return theta.numpy()


def _value(seen: Sequence[_Term], theta: Tensor) -> float:
    return sum(term.value(theta) for term in seen)


class _Term:
    """A Term in torch."""

    def __init__(self, term: Term, model: str, lighting: Lighting) -> None:
        probe = term.probe
        self._model, self._term = model, term
        self._groups, self._points = probe.uv.shape[:2]
        self._single = self._groups * self._points
        self._light, self._view, self._mean = (torch.from_numpy(a) for a in (probe.light, probe.view, probe.mean))
        self._noise, self._signal = (torch.from_numpy(a).float() for a in (probe.noise, probe.signal))
        self._base, self._columns = torch.from_numpy(term.base), torch.from_numpy(term.columns)
        self._other = None if term.other is None else torch.from_numpy(term.other)
        frame = torch.from_numpy(probe.frame)
        direction = torch.from_numpy(lighting.direction.astype(np.float32))
        self._lit_light = torch.einsum("nij,kj->kni", frame, direction)[None]
        self._lit_view = torch.einsum("nij,nj->ni", frame, torch.from_numpy(probe.lit_view))[None, None]
        self._power = torch.from_numpy((EXPOSURE * lighting.radiance).astype(np.float32))[:, None]
        self._displayed = torch.from_numpy(probe.displayed)
        asked = term.asked
        self._asked, self._asked_lit = torch.from_numpy(asked.log_errors.mean(1)).float(), asked.lit_square

    def value(self, theta: Tensor) -> float:
        """What is minimised, in nepers."""
        with torch.no_grad():
            texels = self._texels(theta)
            log = self._relative(self._shaded(texels) - self._mean).log().mean(1)
            lit = (self._lit(texels[self._single :]) - self._displayed).square().mean().clamp(min=FLOOR).log()
        behind = (log - self._asked).clamp(min=0).sum() + _LIT * (lit - self._asked_lit).clamp(min=0)
        return float(log.sum() + _LIT * lit + _BEHIND * behind)

    def equations(self, theta: Tensor, turn: int) -> tuple[Tensor, Tensor]:
        """(J,) slope of the value by the weights, and (J, J) its Gauss-Newton curvature."""
        texels = self._texels(theta).requires_grad_()
        shaded = self._shaded(texels)
        off = shaded.detach() - self._mean
        error = self._relative(off) * self._signal
        urgent = 1 + _BEHIND * ((error / self._signal).log().mean(1) > self._asked)
        # Unlit pairs have no figure, so nothing to gain either.
        count = off[0, 0].numel() * SET_SIZE * self._groups
        weight = torch.where(self._signal > _UNLIT, urgent[:, None] / (error * count).clamp(min=1e-20), 0.0)
        weight = weight.T.repeat_interleave(SET_SIZE, 1)  # (G, K)
        lit = self._lit(texels[self._single :])
        lit_off = lit.detach() - self._displayed
        lit_error = lit_off.square().mean().clamp(min=FLOOR)
        lit_weight = _LIT * (1 + _BEHIND * float(lit_error.log() > self._asked_lit)) / (lit_error * lit.numel())
        torch.autograd.backward([shaded, lit], [2 * off * weight[..., None, None], 2 * lit_off * lit_weight])
        assert texels.grad is not None
        share = self._term.share
        slope = share * torch.einsum("nc,jnc->j", texels.grad, self._columns)
        grams = self._grams(texels.detach(), 2 * weight, turn)
        rows = self._lit_rows(texels.detach()) * (2 * lit_weight).sqrt()
        first, last = self._columns[:, : self._single], self._columns[:, self._single :]
        single = first.reshape(len(first), -1) @ (grams @ first.permute(1, 2, 0)).reshape(-1, len(first))
        along = torch.einsum("nc,jnc->jn", rows, last)
        return slope, share * share * (single + along @ along.T)

    def _texels(self, theta: Tensor) -> Tensor:
        own = _valid(self._base + torch.tensordot(theta, self._columns, 1), self._model)
        return own if self._other is None else self._term.share * own + (1 - self._term.share) * self._other

    def _shaded(self, texels: Tensor) -> Tensor:
        single = texels[: self._single].reshape(self._groups, self._points, -1)
        out: Tensor = shade(self._model, single, self._light, self._view)
        return out

    def _relative(self, off: Tensor) -> Tensor:
        """(S, G) errors relative to the signal."""
        error = off.reshape(self._groups, _SETS, -1).square().mean(-1).T - self._noise
        signal = self._signal.clamp(min=1e-30)
        return (torch.maximum(error, 0.02 * self._noise) / signal).clamp(min=FLOOR)

    def _lit(self, texels: Tensor) -> Tensor:
        view = self._lit_view.expand(1, self._lit_light.shape[1], -1, -1)
        return encoded((shade(self._model, texels, self._lit_light, view)[0] * self._power).sum(0))

    def _lit_rows(self, texels: Tensor) -> Tensor:
        each = texels[self._single :].clone().requires_grad_()
        shown = self._lit(each)
        torch.autograd.backward(shown, _signs(shown.shape, 0))
        assert each.grad is not None
        return each.grad

    def _grams(self, texels: Tensor, weight: Tensor, turn: int) -> Tensor:
        """(N, C, C) J^T w J of each point, from every _STRIDE-th pair and random combinations of its colours."""
        some = slice(turn % _STRIDE, None, _STRIDE)
        light, view = (d[:, some].repeat_interleave(self._points, 1)[:, None] for d in (self._light, self._view))
        single = texels[: self._single].reshape(self._groups, 1, self._points, -1)
        pairs = light.shape[2] // self._points
        each = single.expand(-1, pairs, -1, -1).reshape(self._groups, pairs * self._points, -1).requires_grad_()
        shaded = shade(self._model, each, light, view)
        torch.autograd.backward(shaded, _signs(shaded.shape, turn))
        assert each.grad is not None
        rows = each.grad.reshape(self._groups, pairs, self._points, -1)
        rows = rows * (_STRIDE * weight[:, some]).sqrt()[..., None, None]
        rows = rows.permute(0, 2, 3, 1).flatten(0, 1)  # (N, C, pairs)
        return torch.bmm(rows, rows.transpose(1, 2))


def _signs(shape: torch.Size, seed: int) -> Tensor:
    return 2.0 * torch.randint(0, 2, shape, generator=torch.Generator().manual_seed(seed), dtype=torch.int8) - 1


def _valid(texels: Tensor, model: str) -> Tensor:
    """material.regularise."""
    low, high = texels.new_tensor(MODELS[model].limits).T
    texels = torch.maximum(torch.minimum(texels, high), low)
    for group in MODELS[model].unit_vectors:
        unit = texels[..., group]
        unit = unit / unit.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
        texels = torch.cat([texels[..., : group.start], unit, texels[..., group.stop :]], -1)
    return texels
