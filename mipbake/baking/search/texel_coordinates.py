"""Texels as coordinates to descend on: any numbers, where stored channels have limits and unit lengths.

Colours stay as they are, roughness becomes ln alpha^2, a normal its x and y, and a strength its square; directions stay
as they are. A unit is chosen for each, about as large a change everywhere (`mipbake.material.FACTS`): normals in units
of the lobe's width alpha, since what turns a mirror over is nothing to a rough surface.

Functions are pure and keep dtype and leading shape. `mipbake.models.parameters` has what `to_coordinates`, `to_stored`
and `stored_adjoint` compute in torch, for networks that are trained; tests hold both against each other.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.material import (
    FACTS,
    LEAST_STRENGTH,
    MAX_LOG_ALPHA2,
    MAX_LOG_GAMMA,
    MIN_HEIGHT,
    MIN_LOG_ALPHA2,
    MIN_ROUGHNESS,
    Facts,
    Kind,
    MaterialModel,
    model_named,
    unknown,
)

Reals: TypeAlias = NDArray[Any]
"""float32 or float64."""

_LEAST_ALPHA = 0.02  # width of a lobe that a normal's step is measured in, at least
_SHORTEST = 1e-6  # length of a direction that it is divided by, at least
_ROUND = 1e-12  # added to a square, so that the distance of equal eigenvalues has a derivative


def to_coordinates(stored: Reals, model: str) -> Reals:
    """(..., C) valid stored channels to (..., P) coordinates.

    Roughness is raised to MIN_ROUGHNESS, strength to LEAST_STRENGTH.
    """
    layout = model_named(model)
    if all(FACTS[part.kind].as_stored for part in layout.parts):
        return stored
    return np.concatenate([_to(stored[..., part.channels], part.kind) for part in layout.parts], -1)


def to_stored(coordinates: Reals, model: str) -> Reals:
    """(..., P) coordinates, any numbers, to (..., C) valid stored channels; the inverse of `to_coordinates`."""
    layout = model_named(model)
    parts = [(coordinates[..., part.coordinates], part.kind) for part in layout.parts]
    return np.concatenate([_of(*part, layout.least_alpha2) for part in parts], -1)


def stored_adjoint(coordinates: Reals, gradient: Reals, model: str) -> Reals:
    """(..., P) gradients by the coordinates, of (..., C) gradients by what `to_stored` makes of them.

    A coordinate beyond a limit has no gradient where a descent would lead it farther beyond; where it would lead back,
    the gradient passes, so that nothing gets stuck at a limit.
    """
    layout = model_named(model)
    parts = [(coordinates[..., p.coordinates], gradient[..., p.channels], p.kind) for p in layout.parts]
    return np.concatenate([_adjoint(*part, layout.least_alpha2) for part in parts], -1)


def units(coordinates: Reals, model: str) -> Reals:
    """(..., P): how far a coordinate moves in one step at most."""
    layout = model_named(model)
    steps = np.array([facts.step for facts in _facts(layout)], coordinates.dtype)
    out: Reals = np.broadcast_to(steps, coordinates.shape).copy()
    width = np.exp(np.clip(_log_alpha(coordinates, layout), math.log(_LEAST_ALPHA), 0))
    for part in layout.parts:
        if part.kind in (Kind.NORMAL, Kind.NORMAL_XY):
            out[..., part.coordinates] *= width
    return out


def limits(coordinates: Reals, model: str) -> tuple[Reals, Reals]:
    """(P,) least and largest value of each coordinate."""
    low, high = np.array([facts.range for facts in _facts(model_named(model))], coordinates.dtype).T
    return low, high


def without_heights(gradient: Reals, texels: Reals, model: str) -> Reals:
    """(..., D) gradients by stored channels less the height of the normal, which x and y settle: (..., C) to D.

    texels: (..., C) stored channels that the gradients were taken at.
    """
    layout = model_named(model)
    if not layout.of(Kind.NORMAL):
        return gradient
    out = []
    for part in layout.parts:
        own = gradient[..., part.channels]
        if part.kind is Kind.NORMAL:
            normal = texels[..., part.channels]
            own = own[..., 0:2] - own[..., 2:3] * (normal[..., 0:2] / np.maximum(normal[..., 2:3], MIN_HEIGHT))
        out.append(own)
    return np.concatenate(out, -1)


def per_coordinate(coordinates: Reals, model: str) -> Reals:
    """(..., P) derivative of each channel of `without_heights` by its coordinate."""
    out = np.ones_like(coordinates)
    for part in model_named(model).parts:
        own = coordinates[..., part.coordinates]
        if part.kind is Kind.ROUGHNESS:
            out[..., part.coordinates] = np.exp(own / 4) / 4
        elif part.kind is Kind.STRENGTH:
            out[..., part.coordinates] = 0.5 / np.sqrt(np.maximum(own, LEAST_STRENGTH**2))
        elif part.kind is not Kind.NORMAL and not FACTS[part.kind].as_stored:
            raise AssertionError(f"the derivative of {part.kind} is not known")
    return out


def _facts(layout: MaterialModel) -> list[Facts]:
    """Of each coordinate."""
    return [each.facts for each in layout.stored for _ in range(each.facts.coordinates)]


def _log_alpha(coordinates: Reals, layout: MaterialModel) -> Reals:
    """(..., 1) the logarithm of a lobe's width, the mean over its axes; of the narrower one where a model has lines."""
    for part in layout.parts:
        own = coordinates[..., part.coordinates]
        if part.kind is Kind.ROUGHNESS:
            return own / 2
        if part.kind is Kind.LOG_TENSOR:
            return (own[..., 0:1] + own[..., 1:2]) / 4
    raise AssertionError(f"the width of a lobe of {layout.name} is not known")


def _to(stored: Reals, kind: Kind) -> Reals:
    """`to_coordinates` of the channels of one kind."""
    match kind:
        case Kind.ROUGHNESS:
            out: Reals = 4 * np.log(np.clip(stored, MIN_ROUGHNESS, 1))
        case Kind.NORMAL:
            out = stored[..., :2]
        case Kind.STRENGTH:
            out = np.square(np.clip(stored, LEAST_STRENGTH, 1))
        case Kind.REFLECTANCE | Kind.SHARE | Kind.NORMAL_XY | Kind.DIRECTION | Kind.LOG_TENSOR | Kind.LOG_GAMMA:
            out = stored
        case _:
            unknown(kind)
    return out


def _of(own: Reals, kind: Kind, least_alpha2: float) -> Reals:
    """`to_stored` of the coordinates of one kind."""
    match kind:
        case Kind.REFLECTANCE | Kind.SHARE:
            out: Reals = np.clip(own, 0, 1)
        case Kind.ROUGHNESS:
            out = np.exp(np.clip(own, MIN_LOG_ALPHA2, 0) / 4)
        case Kind.NORMAL:
            xy = _onto_disc(own)
            out = np.concatenate([xy, np.sqrt(_height2(xy))], -1)
        case Kind.NORMAL_XY:
            out = _onto_disc(own)
        case Kind.DIRECTION:
            out = own / np.maximum(np.sqrt(_dot(own, own)), _SHORTEST)
        case Kind.STRENGTH:
            out = np.sqrt(np.clip(own, LEAST_STRENGTH**2, 1))
        case Kind.LOG_TENSOR:
            out = _Eigenvalues(own, math.log(least_alpha2)).tensor()
        case Kind.LOG_GAMMA:
            out = np.clip(own, -MAX_LOG_GAMMA, MAX_LOG_GAMMA)
        case _:
            unknown(kind)
    return out


def _adjoint(own: Reals, gradient: Reals, kind: Kind, least_alpha2: float) -> Reals:
    """`stored_adjoint` of the coordinates of one kind."""
    match kind:
        case Kind.REFLECTANCE | Kind.SHARE:
            out = _inward(own, gradient, 0, 1)
        case Kind.ROUGHNESS:
            roughness = np.exp(np.clip(own, MIN_LOG_ALPHA2, 0) / 4)
            out = _inward(own, gradient * roughness / 4, MIN_LOG_ALPHA2, 0)
        case Kind.NORMAL:
            xy = _onto_disc(own)
            height2 = _height2(xy)
            slope = np.where(height2 > MIN_HEIGHT**2, xy / np.sqrt(height2), 0)
            out = _onto_disc_adjoint(own, gradient[..., :2] - gradient[..., 2:] * slope)
        case Kind.NORMAL_XY:
            out = _onto_disc_adjoint(own, gradient)
        case Kind.DIRECTION:
            length = np.sqrt(_dot(own, own))
            divisor = np.maximum(length, _SHORTEST)
            turned = own * (_dot(own, gradient) / np.square(divisor))
            out = (gradient - np.where(length >= _SHORTEST, turned, 0)) / divisor
        case Kind.STRENGTH:
            strength = np.sqrt(np.clip(own, LEAST_STRENGTH**2, 1))
            out = _inward(own, gradient * 0.5 / strength, LEAST_STRENGTH**2, 1)
        case Kind.LOG_TENSOR:
            out = _Eigenvalues(own, math.log(least_alpha2)).adjoint(gradient)
        case Kind.LOG_GAMMA:
            out = _inward(own, gradient, -MAX_LOG_GAMMA, MAX_LOG_GAMMA)
        case _:
            unknown(kind)
    return out


def _inward(x: Reals, gradient: Reals, low: float, high: float) -> Reals:
    """Gradients by x, of gradients by x clipped to [low, high]: those that point farther outside are 0."""
    outward = ((x < low) & (gradient > 0)) | ((x > high) & (gradient < 0))
    return np.asarray(np.where(outward, 0, gradient))


def _dot(a: Reals, b: Reals) -> Reals:
    """(..., 1) inner products of (..., 2) vectors."""
    return np.asarray(a[..., :1] * b[..., :1] + a[..., 1:] * b[..., 1:])


def _onto_disc(xy: Reals) -> Reals:
    """(..., 2): scaled back onto the unit disc where it lies outside."""
    return np.asarray(xy / np.sqrt(np.maximum(_dot(xy, xy), 1)))


def _onto_disc_adjoint(xy: Reals, gradient: Reals) -> Reals:
    """(..., 2) gradients by xy, of gradients by `_onto_disc` of it: outside, what lies along it is lost."""
    square = _dot(xy, xy)
    divisor2 = np.maximum(square, 1)
    lost = np.where(square >= 1, _dot(xy, gradient) / divisor2, 0)
    return np.asarray((gradient - xy * lost) / np.sqrt(divisor2))


def _height2(xy: Reals) -> Reals:
    """(..., 1) square of the height of normals whose x and y lie in the unit disc."""
    return np.asarray(np.maximum(1 - _dot(xy, xy), MIN_HEIGHT**2))


class _Eigenvalues:
    """A log-roughness tensor whose eigenvalues are held between `least` and MAX_LOG_ALPHA2.

    With d = (a - b) / 2 and the mean m = (a + b) / 2, the eigenvalues are m + radius and m - radius.

    Args:
        log_tensor: (..., 3) a, b, c.
    """

    def __init__(self, log_tensor: Reals, least: float) -> None:
        a, b, self._c = np.moveaxis(log_tensor, -1, 0)
        mean, self._d = (a + b) / 2, (a - b) / 2
        self._radius = np.sqrt(self._d * self._d + self._c * self._c + _ROUND)
        self._ends = least, MAX_LOG_ALPHA2
        self._raw = mean + self._radius, mean - self._radius
        high, low = (np.clip(each, *self._ends) for each in self._raw)
        self._mean, self._shrink = (high + low) / 2, (high - low) / (2 * self._radius)

    def tensor(self) -> Reals:
        """(..., 3) a, b, c of the tensor that is held."""
        along, across = self._shrink * self._d, self._shrink * self._c
        return np.stack([self._mean + along, self._mean - along, across], -1)

    def adjoint(self, gradient: Reals) -> Reals:
        """(..., 3) gradients by the tensor that was given, of gradients by the tensor that is held."""
        by_a, by_b, by_c = np.moveaxis(gradient, -1, 0)
        by_mean, by_along = by_a + by_b, by_a - by_b
        by_shrink = by_along * self._d + by_c * self._c
        split = by_shrink / (2 * self._radius)
        by_high, by_low = (
            _inward(raw, by_mean / 2 + sign * split, *self._ends) for raw, sign in zip(self._raw, (1, -1), strict=True)
        )
        by_radius = by_high - by_low - by_shrink * self._shrink / self._radius
        by_d = by_along * self._shrink + by_radius * self._d / self._radius
        by_across = by_c * self._shrink + by_radius * self._c / self._radius
        half = (by_high + by_low) / 2
        return np.stack([half + by_d / 2, half - by_d / 2, by_across], -1)
