"""Numbers that all texels of a level share, moved by damped Gauss-Newton steps.

A texel learns from the few pixels that look it up. A number that moves all texels of a level alike, such as an offset
of roughness, is seen by every pixel of the level. One more render says how a whole picture follows it, and there are
few such numbers. So least squares find them from few renders, where signs and small steps would take many (Levenberg
1944, *A Method for the Solution of Certain Non-Linear Problems in Least Squares*; Marquardt 1963, *An Algorithm for
Least-Squares Estimation of Nonlinear Parameters*).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake import stochastic
from mipbake.fitting.loop import FitSettings, Loop
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared
from mipbake.fitting.renderer import Array

_DIFFERENCE = 2.0
"""So many quantisation steps, in the root mean square over texels, a number moves its texels by for a difference of
pictures. A guess."""

_DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""A level takes the step with the best of these shares of the curvature added to it. Guesses."""

_LEAST_SHARE = 0.01
"""A view says nothing of a level that less of what its pixels read lies in. A guess."""

_MOST = 1 / 3
"""Rounds take so much of a budget at most. A guess."""

_FEWEST = 8
"""Where a budget is so short that only every such view or fewer could be learned from, there are no rounds. A guess."""

_HELD = 2**24
"""Derivatives of so many pixels are held at once, about 400 MB of them. A guess."""

_STOPPED = 0.25
"""A number stays where it is where limits of channels leave less than so much of what its texels move by, in squares.
A guess."""

_FLOOR = 1e-6
"""So much of the mean curvature is added everywhere: numbers that do the same have one answer. A guess."""


@dataclass(frozen=True, eq=False)
class SharedNumbers:
    """What may move of each level: an offset of each channel, and the contrast of each map around its mean."""

    parameters: Parameters

    def directions(self, values: Array, level: int) -> Iterator[Array]:
        """(texels of the level, channels) float32 for each number: how far texels move where the number grows by 1.

        It is `_DIFFERENCE` in the root mean square over texels. There is no direction along which nothing moves.
        """
        own = slice(*self.parameters.starts[level : level + 2])
        channels = self.parameters.channels
        steps = np.asarray(channels.magnitude, np.float32)  # 0 for what follows from other channels
        here = values[own]
        for first, last in ((each.start, each.stop) for each in self.parameters.model.maps.values()):
            inside = (np.arange(len(steps)) >= first) & (np.arange(len(steps)) < last) & (steps > 0)
            offsets = (np.eye(len(steps), dtype=np.float32)[index] for index in np.flatnonzero(inside))
            contrast = here - here.mean(0)
            for moved in (*offsets, contrast):
                kept = np.where(inside, np.broadcast_to(moved, here.shape), np.float32(0))
                size = np.divide(kept, steps, out=np.zeros_like(kept), where=steps > 0)
                length = float(np.sqrt(np.square(size, dtype=np.float64).sum(-1).mean()))
                if length > 1e-3:  # of a quantisation step, less is rounding
                    yield kept * np.float32(_DIFFERENCE / length)

    def moved(self, values: Array, level: int, by: Array) -> Array:
        """(texels of the level, channels) of these values, moved, within the limits of channels."""
        channels = self.parameters.channels
        own = values[slice(*self.parameters.starts[level : level + 2])]
        moved = self._limited(own + by)
        still = replace(channels, magnitude=tuple(0.0 for _ in channels.magnitude))
        return np.asarray(stochastic.perturb(moved, still, 0, 0)[0])  # with normals of unit length

    def reached(self, values: Array, level: int, by: Array) -> float:
        """How much of the sum of squares of a move the limits of channels leave, from 0 to 1; 1 of no move."""
        own = values[slice(*self.parameters.starts[level : level + 2])]
        wanted = float(np.square(by, dtype=np.float64).sum())
        return float(np.square(self._limited(own + by) - own, dtype=np.float64).sum()) / wanted if wanted > 0 else 1.0

    def _limited(self, values: Array) -> Array:
        channels = self.parameters.channels
        return np.clip(values, np.asarray(channels.low, np.float32), np.asarray(channels.high, np.float32))


@dataclass(frozen=True, eq=False)
class Rounds:
    """Gauss-Newton steps that end a fit.

    Args:
        numbers: that move.
        count: of rounds.
        movable: numbers of the levels that may move.
        learning: views that derivatives are taken in.
        seconds: of the budget that the rounds are expected to take; 0 where there is none.
        share: of the whole fit that they are, about, from 0 to 1.
    """

    numbers: SharedNumbers
    count: int
    movable: Sequence[int]
    learning: Sequence[Prepared]
    seconds: float
    share: float

    @staticmethod
    def planned(
        loop: Loop,
        values: Array,
        views: tuple[Sequence[Prepared], Sequence[Prepared]],
        movable: Sequence[int],
        settings: FitSettings,
    ) -> Rounds:
        """Rounds that take a share of the budget at most: few of the views are learned from where there are too many.

        Args:
            values: (texels, channels), about as they will be.
            views: to learn from, and those that are held out. movable: numbers of the levels that may move.
        """
        learning, checking = views
        numbers, rounds = SharedNumbers(loop.parameters), settings.rounds
        counts = {level: sum(1 for _ in numbers.directions(values, level)) for level in movable}
        derived = sum(1 + sum(counts[n] for n in movable if view.shares[n] >= _LEAST_SHARE) for view in learning)
        judged = (len(_DAMPINGS) + 1 + len(movable)) * (len(learning) + len(checking))
        if settings.budget is None or not rounds:
            steps = math.inf if settings.last is None else settings.last
            renders = rounds * (derived + judged)
            return Rounds(numbers, rounds, movable, learning, 0.0, renders / (renders + 2 * steps * settings.renders))
        began = time.monotonic()
        loop.errors(values, checking)
        pace = (time.monotonic() - began) / len(checking)
        left = _MOST * settings.budget / rounds / pace - judged
        every = math.ceil(derived / left) if left > 0 else math.inf
        if every > _FEWEST:
            return Rounds(numbers, 0, movable, learning, 0.0, 0.0)
        seconds = rounds * pace * (derived / every + judged)
        return Rounds(numbers, rounds, movable, learning[:: int(every)], seconds, seconds / settings.budget)

    @property
    def told(self) -> str:
        """How a sentence on the steps of a fit goes on; empty where there are no rounds."""
        return f" and {self.count} round{'' if self.count == 1 else 's'} of least squares" if self.count else ""

    def run(self, loop: Loop, values: Array, judging: Sequence[Prepared]) -> Array:
        """The values after all rounds.

        Args:
            loop: what renders. values: (texels, channels) to begin with.
            judging: views that say how far each level goes.

        Returns:
            (texels, channels). A level that gains nothing stays bit for bit.
        """
        for _ in range(self.count):
            equations = _Equations.of(loop, self.numbers, values, self.learning, self.movable)
            if not equations.right.any():
                break
            variants = [values, *(equations.stepped(self.numbers, values, damping) for damping in _DAMPINGS)]
            values = loop.parameters.joined(variants, loop.chosen(variants, judging))
        return values


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of least squares: `matrix` @ numbers = `right` where views are right to first order.

    Args:
        levels: which level each number is of, in increasing order.
        matrix: float64, sums over pixels of products of two derivatives. right: of a derivative and what is missing.
    """

    levels: NDArray[np.int64]
    matrix: NDArray[np.float64]
    right: NDArray[np.float64]

    @staticmethod
    def of(
        loop: Loop, numbers: SharedNumbers, values: Array, views: Sequence[Prepared], movable: Sequence[int]
    ) -> _Equations:
        """Those of views, by a render of each for each number that moves what it shows."""
        counts = {level: sum(1 for _ in numbers.directions(values, level)) for level in movable}
        levels = np.repeat(list(counts), list(counts.values())).astype(np.int64)
        matrix, right = np.zeros((len(levels), len(levels))), np.zeros(len(levels))
        told = [np.isin(levels, np.flatnonzero(view.shares >= _LEAST_SHARE)) for view in views]
        resting = loop.levels_of(values)
        pictures = [loop.compared(resting, view) for view in views]
        scratch = values.copy()
        for part in _parts([len(picture) * int(own.sum()) for picture, own in zip(pictures, told, strict=True)]):
            columns: dict[int, list[Array]] = {index: [] for index in part if told[index].any()}
            number = 0
            for level in counts:
                texels = slice(*numbers.parameters.starts[level : level + 2])
                for direction in numbers.directions(values, level):
                    seen = [index for index in columns if told[index][number]]
                    if seen:
                        scratch[texels] = numbers.moved(values, level, direction)
                        moved = loop.levels_with(scratch, level)
                        for index in seen:
                            picture = loop.compared(moved, views[index])
                            columns[index].append(_difference(picture, pictures[index], views[index]))
                    number += 1
                scratch[texels] = values[texels]
            for index, own in columns.items():
                derivatives, shown = np.stack(own), np.flatnonzero(told[index])
                matrix[np.ix_(shown, shown)] += derivatives @ derivatives.T
                right[shown] += derivatives @ _difference(views[index].wanted, pictures[index], views[index])
        return _Equations(levels, matrix, right)

    def stepped(self, numbers: SharedNumbers, values: Array, damping: float) -> Array:
        """The values after a damped step.

        A number that limits of channels would stop stays where it is, and the others make up for it: a metallic map of
        0 cannot fall, for one.
        """
        scale = np.diag(self.matrix)
        damped = self.matrix + np.diag(damping * scale + _FLOOR * scale.mean())
        moving = scale > 0
        while True:
            found = np.zeros(len(self.right))
            found[moving] = np.linalg.solve(damped[np.ix_(moving, moving)], self.right[moving])
            stepped, stopped = self._applied(numbers, values, found)
            if not stopped.any():
                return stepped
            moving &= ~stopped

    def _applied(
        self, numbers: SharedNumbers, values: Array, found: NDArray[np.float64]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """The values, moved; and which numbers move texels by less than half of what they should, by themselves."""
        stepped, stopped = values.copy(), np.zeros(len(found), np.bool_)
        for level in np.unique(self.levels):
            own = np.flatnonzero(self.levels == level)
            total = np.float32(0)
            for number, direction in zip(own, numbers.directions(values, int(level)), strict=True):
                by = direction * np.float32(found[number])
                stopped[number] = numbers.reached(values, int(level), by) < _STOPPED
                total = total + by
            stepped[slice(*numbers.parameters.starts[level : level + 2])] = numbers.moved(values, int(level), total)
        return stepped, stopped


def _difference(picture: Array, resting: Array, view: Prepared) -> Array:
    """(3 parts P,) what a view counts of a difference of pictures."""
    return ((picture - resting) * view.shown[:, None]).ravel()


def _parts(sizes: Sequence[int]) -> Iterator[list[int]]:
    """Numbers of views whose derivatives are held at once, for (pixels x numbers) of each view."""
    part: list[int] = []
    held = 0
    for index, size in enumerate(sizes):
        if part and held + size > _HELD:
            yield part
            part, held = [], 0
        part.append(index)
        held += size
    if part:
        yield part
