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
pictures."""

_DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""A level takes the step with the best of these shares of the curvature added to it."""

_LEAST_SHARE = 0.01
"""Pixels of a view read several levels. A level takes part in a view where it has this share of what they read."""

_MOST = 1 / 3
"""All rounds together take so much of a budget at most."""

_WIDEST = 8
"""Of each scale, every view up to every eighth one is learned from. Where even that takes too long, there are no
rounds."""

_PIXELS = 2**14
"""About so many pixels of a view are learned from."""

_HELD = 2**24
"""Derivatives of so many pixels are held at once, about 400 MB. One view alone may have more."""

_SAMPLED = 2**16
"""Means and spreads of a level, and what its limits leave, are taken from about so many of its texels."""

_STOPPED = 0.25
"""A number stays where it is where limits of channels leave a smaller share of what its texels move by, in squares."""

_FLOOR = 1e-6
"""So much of the mean curvature is added everywhere: numbers that do the same have one answer."""

_TRIES = 3
"""A step is computed about so often, because limits stop numbers."""


@dataclass(frozen=True)
class Number:
    """A number that all texels of a level share. It is in units of `_DIFFERENCE`.

    Args:
        level: whose texels move. channels: that move.
        factor: how far they move where the number grows by 1: for an offset, to all the same. Otherwise it is a share
            of how far they are from their mean, or from another stack.
        contrast: whether it moves the contrast of a map.
        other: number of the stack that it moves a map towards; None where it does not.
    """

    level: int
    channels: tuple[int, ...]
    factor: float
    contrast: bool = False
    other: int | None = None


@dataclass(frozen=True, eq=False)
class SharedNumbers:
    """What may move of each level: an offset of each channel, the contrast of each map around its mean, and how far a
    map lies towards the same map of other stacks.

    Args:
        parameters: of the stacks.
        others: values of these stacks, (texels, channels).
    """

    parameters: Parameters
    others: Sequence[Array] = ()

    def of(self, values: Array, level: int) -> list[Number]:
        """The numbers of a level. There is none that moves nothing."""
        steps = np.asarray(self.parameters.channels.magnitude)  # 0 for what follows from other channels
        sampled = self._sampled(values, level)
        away: dict[int | None, NDArray[np.float64]] = {None: sampled - self._mean(values, level)}
        for index, other in enumerate(self.others):
            away[index] = self._sampled(other, level) - sampled
        found = []
        for each in self.parameters.model.maps.values():
            own = tuple(index for index in range(each.start, each.stop) if steps[index] > 0)
            found += [Number(level, (index,), _DIFFERENCE * float(steps[index])) for index in own]
            for toward, distance in away.items():
                size = float(np.sqrt(np.square(distance[:, own] / steps[list(own)]).sum(-1).mean()))
                if size > 1e-3:  # quantisation steps; less is rounding
                    found.append(Number(level, own, _DIFFERENCE / size, toward is None, toward))
        return found

    def moved(self, values: Array, level: int, numbers: Sequence[Number], by: Sequence[float]) -> Array:
        """(texels of the level, channels) of these values, with numbers of the level moved, within the limits."""
        channels = self.parameters.channels
        offsets, gains, *parts = np.zeros((2 + len(self.others), self.parameters.model.channels), np.float32)
        for number, amount in zip(numbers, by, strict=True):
            moving = parts[number.other] if number.other is not None else gains if number.contrast else offsets
            moving[list(number.channels)] += np.float32(amount * number.factor)
        offsets -= gains * self._mean(values, level)
        moved = values[self._own(level)] * (1 + gains - sum(parts)) + offsets
        for part, other in zip(parts, self.others, strict=True):
            if part.any():
                moved += part * other[self._own(level)]
        np.clip(moved, np.asarray(channels.low, np.float32), np.asarray(channels.high, np.float32), out=moved)
        still = replace(channels, magnitude=tuple(0.0 for _ in channels.magnitude))
        return np.asarray(stochastic.perturb(moved, still, 0, 0)[0])  # with normals of unit length

    def reached(self, values: Array, number: Number, by: float) -> float:
        """How much of the sum of squares of a move the limits of channels leave, from 0 to 1; 1 of no move."""
        channels, own = self.parameters.channels, list(number.channels)
        before = self._sampled(values, number.level)[:, own]
        wanted = np.full_like(before, by * number.factor)
        if number.other is not None:
            wanted *= self._sampled(self.others[number.other], number.level)[:, own] - before
        elif number.contrast:
            wanted *= before - self._mean(values, number.level)[own]
        got = np.clip(before + wanted, np.asarray(channels.low)[own], np.asarray(channels.high)[own]) - before
        energy = float(np.square(wanted).sum())
        return float(np.square(got).sum()) / energy if energy > 0 else 1.0

    def _own(self, level: int) -> slice:
        return slice(*self.parameters.starts[level : level + 2])

    def _sampled(self, values: Array, level: int) -> NDArray[np.float64]:
        own = values[self._own(level)]
        return own[:: -(-len(own) // _SAMPLED)].astype(np.float64)

    def _mean(self, values: Array, level: int) -> Array:
        return np.asarray(self._sampled(values, level).mean(0), np.float32)


@dataclass(frozen=True, eq=False)
class Rounds:
    """Gauss-Newton steps that end a fit.

    Args:
        shared: what moves.
        count: of rounds, at most.
        movable: numbers of the levels that may move.
        learning: views that derivatives are taken in.
        seconds: of the budget that the rounds are expected to take; 0 where there is none.
        share: of the whole fit that they are, about, from 0 to 1.
    """

    shared: SharedNumbers
    count: int
    movable: Sequence[int]
    learning: Sequence[Prepared]
    seconds: float = 0.0
    share: float = 0.0

    @staticmethod
    def planned(
        loop: Loop,
        values: Array,
        views: tuple[Sequence[Prepared], Sequence[Prepared]],
        movable: Sequence[int],
        settings: FitSettings,
        others: Sequence[Array] = (),
    ) -> Rounds:
        """Rounds that take a share of the budget at most: few of the views are learned from where there are too many.

        Args:
            values: (texels, channels), about as they will be.
            views: to learn from, and those that are held out. movable: numbers of the levels that may move.
            others: values of stacks that levels may move towards.
        """
        learning, checking = views
        shared, rounds = SharedNumbers(loop.parameters, others), settings.rounds
        if not rounds or not movable:
            return Rounds(shared, 0, movable, learning)
        # Once steps have moved a level, each of its maps can move back towards the stack that it started from, as well.
        back = len(loop.parameters.model.maps) if others and settings.last != 0 else 0
        counts = {level: len(shared.of(values, level)) + back for level in movable}
        derived = sum(1 + sum(counts[n] for n in movable if view.shares[n] >= _LEAST_SHARE) for view in learning)
        judged = (2 * len(_DAMPINGS) + 2 + len(movable)) * (len(learning) + len(checking))
        if settings.budget is None:
            steps = math.inf if settings.last is None else settings.last
            renders = rounds * (derived + judged)
            return Rounds(shared, rounds, movable, learning, 0.0, renders / (renders + 2 * steps * settings.renders))
        began = time.monotonic()
        for level in movable:
            shared.moved(values, level, (), ())
        texels = (time.monotonic() - began) * (max(counts.values()) + 2 * _TRIES * len(_DAMPINGS))
        began = time.monotonic()
        loop.errors(values, checking)
        pace = (time.monotonic() - began) / len(checking)
        left = (_MOST * settings.budget / rounds - texels) / pace - judged
        every = math.ceil(derived / left) if left > 0 else math.inf
        if every > _WIDEST:
            return Rounds(shared, 0, movable, learning)
        chosen = _thinned(learning, int(every))
        seconds = rounds * (texels + pace * (judged + derived * len(chosen) / len(learning)))
        return Rounds(shared, rounds, movable, chosen, seconds, min(seconds / settings.budget, _MOST))

    def run(self, loop: Loop, values: Array, judging: Sequence[Prepared]) -> tuple[Array, int]:
        """The values after all rounds, and how many rounds there were: none follows one that changes nothing.

        Args:
            loop: what renders. values: (texels, channels) to begin with.
            judging: views that say how far each level goes.

        Returns:
            (texels, channels). A level that gains nothing stays bit for bit.
        """
        for done in range(self.count):
            equations = _Equations.of(loop, self.shared, values, self.learning, self.movable)
            if not equations.right.any():
                return values, done
            variants = [values]
            for damping in _DAMPINGS:
                variants += [equations.stepped(self.shared, values, damping, alone) for alone in (False, True)]
            chosen = loop.chosen(variants, judging)
            if not chosen.any():
                return values, done
            values = loop.parameters.joined(variants, chosen)
        return values, self.count


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of least squares: `matrix` @ amounts = `right` where views are right to first order.

    Args:
        numbers: that move, in the order of their levels.
        matrix: float64, sums over pixels of products of two derivatives. right: of a derivative and what is missing.
    """

    numbers: Sequence[Number]
    matrix: NDArray[np.float64]
    right: NDArray[np.float64]

    @staticmethod
    def of(
        loop: Loop, shared: SharedNumbers, values: Array, views: Sequence[Prepared], movable: Sequence[int]
    ) -> _Equations:
        """Those of views, by a render of each for each number of a level that takes part in it."""
        numbers = [number for level in movable for number in shared.of(values, level)]
        levels = np.array([number.level for number in numbers], np.int64)
        matrix, right = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
        told = [np.isin(levels, np.flatnonzero(view.shares >= _LEAST_SHARE)) for view in views]
        resting = loop.levels_of(values)
        pictures = [_thin(loop.compared(resting, view), view) for view in views]
        scratch = values.copy()
        for part in _parts([len(picture) * int(own.sum()) for picture, own in zip(pictures, told, strict=True)]):
            columns: dict[int, list[Array]] = {index: [] for index in part if told[index].any()}
            for at, number in enumerate(numbers):
                seen = [index for index in columns if told[index][at]]
                if not seen:
                    continue
                # To the side that limits leave free: what lies at a limit can move away from it alone.
                side = 1.0 if shared.reached(values, number, 1.0) >= shared.reached(values, number, -1.0) else -1.0
                own = slice(*loop.parameters.starts[number.level : number.level + 2])
                scratch[own] = shared.moved(values, number.level, [number], [side])
                moved = loop.levels_with(scratch, number.level)
                for index in seen:
                    picture = _thin(loop.compared(moved, views[index]), views[index])
                    columns[index].append((side * (picture - pictures[index])).ravel())
                scratch[own] = values[own]
            for index, derivatives in columns.items():
                every, shown = np.stack(derivatives), np.flatnonzero(told[index])
                missing = _thin(views[index].wanted, views[index]) - pictures[index]
                matrix[np.ix_(shown, shown)] += every @ every.T
                right[shown] += every @ missing.ravel()
        return _Equations(numbers, matrix, right)

    def stepped(self, shared: SharedNumbers, values: Array, damping: float, alone: bool = False) -> Array:
        """The values after a damped step.

        Where a level moves `alone`, no number that moves it towards another stack does: fewer numbers follow views that
        were learned from less closely.

        A number that limits of channels would stop stays where it is, and the others make up for it: a metallic map of
        0 cannot fall, for one.
        """
        scale = np.diag(self.matrix)
        damped = self.matrix + np.diag(damping * scale + _FLOOR * scale.mean())
        moving = (scale > 0) & ~np.array([alone and number.other is not None for number in self.numbers], bool)
        while True:
            found = np.zeros(len(self.right))
            found[moving] = np.linalg.solve(damped[np.ix_(moving, moving)], self.right[moving])
            reached = [shared.reached(values, *each) for each in zip(self.numbers, found.tolist(), strict=True)]
            stopped = np.array(reached) < _STOPPED
            if not stopped.any():
                break
            moving &= ~stopped
        stepped: Array = values.copy()
        for level in {number.level for number in self.numbers}:
            own = [index for index, number in enumerate(self.numbers) if number.level == level]
            moved = shared.moved(values, level, [self.numbers[index] for index in own], found[own].tolist())
            stepped[slice(*shared.parameters.starts[level : level + 2])] = moved
        return stepped


def _thinned(views: Sequence[Prepared], every: int) -> list[Prepared]:
    """Every so-manieth view of each scale, the first of each among them."""
    counts: dict[str, int] = {}
    kept = []
    for view in views:
        if counts.setdefault(view.scale, 0) % every == 0:
            kept.append(view)
        counts[view.scale] += 1
    return kept


def _thin(picture: Array, view: Prepared) -> Array:
    """Some of the pixels (P, 3 parts), and 0 for those that do not count."""
    every = -(-len(picture) // _PIXELS) | 1  # odd, so that not the same columns are taken of all rows
    return np.asarray(picture[::every] * view.shown[::every, None], np.float32)


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


def rounds_told(count: int) -> str:
    """How a sentence on the steps of a fit goes on; empty where there were no rounds."""
    return f" and {count} round{'' if count == 1 else 's'} of least squares" if count else ""
