"""The method of Gauss and Newton on blocks of unknowns, damped as by Levenberg and Marquardt.

Both searches stand on it. The shares of a blend are one block of some twenty unknowns, whose renders stay the same:
a step is taken where the value falls, and damped until it does (level_fit.py). Texels are many blocks of a handful of
unknowns, whose renders are drawn anew in every round, so that no value can be compared: all take a few steps, held
where they are by the curvature of past rounds (texel_descent.py).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_ABSOLUTE = 1e-3  # damping in units of the mean over blocks; a guess
_BLOCKS = 2048  # blocks whose equations are solved at a time: they stay in the cache
_TRIES, _STRONGER, _WEAKER = 4, 10.0, 0.2  # dampings that are tried in a round, and how damping changes; a guess


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
        start: Tensor,
        own: Tensor,
        held: Tensor | None,
        unit: Tensor,
        limits: tuple[Tensor, Tensor],
        damping: float,
    ) -> None:
        self._start, self._own, self._held, self._unit = start, own, held, unit
        self._low, self._high = limits
        self._damping = damping
        diagonal = own.diagonal(dim1=-2, dim2=-1)
        if held is not None:
            diagonal = diagonal + held.diagonal(dim1=-2, dim2=-1)
        self._least = _ABSOLUTE * (diagonal * unit.square()).mean(0) + 1e-12
        self._factors: list[tuple[Tensor, Tensor]] = []

    def damped(self, damping: float) -> System:
        """The same equations, damped otherwise."""
        return System(self._start, self._own, self._held, self._unit, (self._low, self._high), damping)

    def stepped(self, here: Tensor, gradient: Tensor) -> Tensor:
        """(B, P) unknowns a step from `here`, none of them farther than a unit.

        An unknown at a limit that the first step would lead it out of stays where it is for all of the round.
        """
        out = torch.empty_like(here)
        first = not self._factors
        for index, begin in enumerate(range(0, len(here), _BLOCKS)):
            some = slice(begin, begin + _BLOCKS)
            unit, pull = self._unit[some], gradient[some]
            if self._held is not None:
                pull = pull + (self._held[some] @ (here[some] - self._start[some])[..., None])[..., 0]
            if first:
                leaving = ((here[some] <= self._low) & (pull > 0)) | ((here[some] >= self._high) & (pull < 0))
                self._factors.append(self._factor(some, leaving))
            factor, free = self._factors[index]
            step = torch.cholesky_solve((pull * unit * free)[..., None], factor)[..., 0].nan_to_num(0, 0, 0)
            moved = here[some] - unit * step / step.abs().amax(-1, keepdim=True).clamp(min=1)
            out[some] = moved.maximum(self._low).minimum(self._high)
        return out

    def energy(self, here: Tensor) -> float:
        """What leaving the start costs."""
        if self._held is None:
            return 0.0
        away = (here - self._start)[..., None]
        return 0.5 * float((away.mT @ self._held @ away).sum())

    def _factor(self, some: slice, fixed: Tensor) -> tuple[Tensor, Tensor]:
        """The Cholesky factors of some blocks in units, and 1 for the unknowns that are free in them, else 0."""
        free = 1 - fixed.to(self._unit.dtype)
        matrix = self._own[some] if self._held is None else self._own[some] + self._held[some]
        scale = self._unit[some] * free
        matrix = matrix * scale[..., :, None] * scale[..., None, :]
        diagonal = matrix.diagonal(dim1=-2, dim2=-1)
        diagonal += self._damping * diagonal + self._least * free + (1 - free)
        factor, _ = torch.linalg.cholesky_ex(matrix)
        return factor, free


def accepted(
    system: System, here: Tensor, gradient: Tensor, value: Callable[[Tensor], float], before: float, damping: float
) -> tuple[Tensor, float, float] | None:
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
