"""The method of Gauss and Newton on blocks of unknowns, damped as by Levenberg and Marquardt.

Both searches stand on it. The shares of a blend are one block of some twenty unknowns, whose renders stay the same:
a step is taken where the value falls, and damped until it does (level_fit.py). Texels are many blocks of a handful of
unknowns, whose renders are drawn anew in every round, so that no value can be compared: all take a few steps, held
where they are by the curvature of past rounds (texel_descent.py).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.floating]

_ABSOLUTE = 1e-3  # damping in units of the mean over blocks
_BLOCKS = 2048  # blocks whose equations are solved at a time: they stay in the cache
_TRIES, _STRONGER, _WEAKER = 4, 10.0, 0.2  # dampings that are tried in a round, and how damping changes


class System:
    """The equations of a round: what a gradient is divided by, and what holds unknowns in place.

    Args:
        start: (B, P) where the unknowns are held.
        own, held: (B, P, P) curvature of this round, and what holds the unknowns; None for nothing.
        unit: (B, P) how far an unknown moves in one step at most.
        limits: (P,) least and largest value of each unknown.
        damping: in units of a block's own curvature.
    """

    def __init__(
        self,
        start: Reals,
        own: Reals,
        held: Reals | None,
        unit: Reals,
        limits: tuple[Reals, Reals],
        damping: float,
    ) -> None:
        self._start, self._own, self._held, self._unit = start, own, held, unit
        self._low, self._high = limits
        self._damping = damping
        diagonal = _diagonals(own) if held is None else _diagonals(own) + _diagonals(held)
        # In double precision: NumPy adds up rows one by one, of which there may be hundreds of thousands.
        mean = (diagonal * np.square(unit)).mean(0, dtype=np.float64)
        self._least = (_ABSOLUTE * mean + 1e-12).astype(unit.dtype)
        self._factors: list[tuple[Reals, Reals]] = []

    def damped(self, damping: float) -> System:
        """The same equations, damped otherwise."""
        return System(self._start, self._own, self._held, self._unit, (self._low, self._high), damping)

    def stepped(self, here: Reals, gradient: Reals) -> Reals:
        """(B, P) unknowns a step from `here`, none of them farther than a unit.

        An unknown at a limit that the first step would lead it out of stays where it is for all of the round. Blocks
        whose equations have no solution, as where a curvature is not finite, do not move.
        """
        out = np.empty_like(here)
        first = not self._factors
        for index, begin in enumerate(range(0, len(here), _BLOCKS)):
            some = slice(begin, begin + _BLOCKS)
            unit, pull = self._unit[some], gradient[some]
            if self._held is not None:
                pull = pull + _times(self._held[some], here[some] - self._start[some])
            if first:
                leaving = ((here[some] <= self._low) & (pull > 0)) | ((here[some] >= self._high) & (pull < 0))
                self._factors.append(self._factor(some, leaving))
            factor, free = self._factors[index]
            step = solved(factor, pull * unit * free)
            moved = here[some] - unit * step / np.maximum(np.abs(step).max(-1, keepdims=True), 1)
            out[some] = np.clip(moved, self._low, self._high)
        return out

    def energy(self, here: Reals) -> float:
        """What leaving the start costs."""
        if self._held is None:
            return 0.0
        away = here - self._start
        return 0.5 * float((away * _times(self._held, away)).sum())

    def _factor(self, some: slice, fixed: NDArray[np.bool_]) -> tuple[Reals, Reals]:
        """The Cholesky factors of some blocks in units, and 1 for the unknowns that are free in them, else 0."""
        free = (~fixed).astype(self._unit.dtype)
        matrix = self._own[some] if self._held is None else self._own[some] + self._held[some]
        scale = self._unit[some] * free
        matrix = matrix * scale[..., :, None] * scale[..., None, :]
        each = np.arange(matrix.shape[-1])
        matrix[:, each, each] += self._damping * matrix[:, each, each] + self._least * free + (1 - free)
        return factored(matrix), free


def _diagonals(matrices: Reals) -> Reals:
    """(B, P) of (B, P, P)."""
    return np.diagonal(matrices, axis1=-2, axis2=-1)


def _times(matrices: Reals, vectors: Reals) -> Reals:
    """(B, P) products of (B, P, P) and (B, P)."""
    return np.asarray(np.matmul(matrices, vectors[..., None])[..., 0])


def accepted(
    system: System, here: Reals, gradient: Reals, value: Callable[[Reals], float], before: float, damping: float
) -> tuple[Reals, float, float] | None:
    """A step by which the value falls, the value there, and the damping to go on with; None where there is none.

    Args:
        value: what is minimised besides `System.energy`. before: both, at (B, P) here.
    """
    for _ in range(_TRIES):
        tried = system.damped(damping).stepped(here, gradient)
        now = value(tried) + system.energy(tried)
        if now < before:
            return tried, now, damping * _WEAKER
        damping *= _STRONGER
    return None


def signs(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    """Random signs. Of renders r with derivatives J, the mean of (J^T s)(J^T s)^T over signs s is J^T J."""
    return np.asarray(2 * rng.integers(0, 2, shape, np.int8) - 1, np.float32)


def factored(matrices: Reals) -> Reals:
    """(P, P, B) lower triangular factors L of (B, P, P) symmetric matrices L L^T; what is above the diagonal is 0.

    NumPy's own solvers call a library once for each matrix, and raise where one of them is not positive definite. Here
    a step of Cholesky's method is one operation on all matrices at once, whose axis comes last.

    The upper halves of the matrices are not read. Factors hold NaN where a matrix is not positive definite.
    """
    rest = np.ascontiguousarray(np.moveaxis(matrices, 0, -1))
    factors = np.zeros_like(rest)
    with np.errstate(all="ignore"):
        for j in range(len(rest)):
            column = rest[j:, j] - np.einsum("ikb,kb->ib", factors[j:, :j], factors[j, :j])
            factors[j:, j] = column / np.sqrt(column[0])
    return factors


def solved(factors: Reals, right: Reals) -> Reals:
    """(B, P) solutions of the equations of `factored` with (B, P) right sides; 0 where a matrix has none."""
    out = np.array(right.T, order="C")
    with np.errstate(all="ignore"):
        for j in range(len(out)):
            out[j] -= np.einsum("kb,kb->b", factors[j, :j], out[:j])
            out[j] /= factors[j, j]
        for j in reversed(range(len(out))):
            out[j] -= np.einsum("kb,kb->b", factors[j + 1 :, j], out[j + 1 :])
            out[j] /= factors[j, j]
    return np.asarray(np.where(np.isfinite(out), out, 0).T)
