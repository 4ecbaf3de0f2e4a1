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
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake import stochastic
from mipbake.fitting.loop import Loop
from mipbake.fitting.prepared import Prepared, shown
from mipbake.fitting.renderer import Array
from mipbake.fitting.schedule import TICK

_DIFFERENCE = 2.0
"""So many quantisation steps, in the root mean square over texels, a number moves its texels by for a difference of
pictures."""

_DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""A level takes the step with the best of these shares of the curvature added to it."""

_LEAST_SHARE = 0.01  # a level takes part in a view where it has this share of what pixels read
_SHOWN = 3  # levels in a view, about
_WIDEST = 8  # of each scale at least every eighth view is learned from; where that takes too long, there are no rounds
_PIXELS = 2**14  # of a view are learned from, about
_HELD = 2**24  # pixels whose derivatives are held at once, about 400 MB; one view alone may have more
_SAMPLED = 2**16  # texels of a level that means and spreads, and what limits leave, are taken from, about
_FLOOR = 1e-6  # of the mean curvature is added everywhere: numbers that do the same have one answer
_TRIES = 3  # a step is computed about so often, because limits stop numbers

_STOPPED = 0.25
"""A number stays where it is where limits of channels leave a smaller share of what its texels move by, in squares."""

_MEAN = -1


@dataclass(frozen=True)
class Number:
    """A number that all texels of a level share. It is in units of `_DIFFERENCE`.

    Args:
        level: whose texels move. channels: that move.
        factor: how far they move where the number grows by 1; for an offset all alike, otherwise as a share of how far
            they are from their mean, or from another stack.
        toward: number of the stack that the channels move towards; _MEAN where they move away from their mean, which
            changes the contrast of a map; None for an offset.
    """

    level: int
    channels: list[int]
    factor: float
    toward: int | None = None


@dataclass(frozen=True, eq=False)
class Rounds:
    """Gauss-Newton steps of what may move of each level: an offset of each channel, the contrast of each map around its
    mean, and how far a map lies towards the same map of other stacks.

    Args:
        others: values of these stacks, (texels, channels).
        movable: numbers of the levels that may move.
        learning: views that derivatives are taken in.
        judging: views that say how far each level goes.
        count: of rounds, at most.
        seconds: that they are expected to take; 0 where they may take as long as they like.
    """

    loop: Loop
    others: Sequence[Array]
    movable: Sequence[int]
    learning: Sequence[Prepared]
    judging: Sequence[Prepared]
    count: int
    seconds: float = 0.0

    @staticmethod
    def planned(
        loop: Loop,
        values: Array,
        learning: Sequence[Prepared],
        checking: Sequence[Prepared],
        others: Sequence[Array] = (),
        limit: float = math.inf,
    ) -> Rounds:
        """Rounds that take so many seconds at most: few of the views are learned from where there are too many.
        `values` are about as they will be."""
        movable = np.flatnonzero(shown(checking)).tolist()
        count = loop.settings.rounds if movable else 0
        rounds = Rounds(loop, others, movable, learning, [*learning, *checking], count)
        if not count or limit == math.inf:
            return rounds
        # Once steps have moved a level, each of its maps can move back towards the stack that it started from, as well.
        back = len(loop.parameters.model.maps) if others and loop.settings.last != 0 else 0
        counts = {level: len(rounds.numbers(values, level)) + back for level in movable}
        judged = 2 * len(_DAMPINGS) + 2 + _SHOWN  # renders of each view, about
        derived = sum(counts[n] for view in learning for n in movable if view.shares[n] >= _LEAST_SHARE)
        learned = derived + (1 + judged) * len(learning)
        began = time.monotonic()
        for level in movable:
            rounds.moved(values, level, (), ())
        texels = (time.monotonic() - began) * (max(counts.values()) + 2 * _TRIES * len(_DAMPINGS))
        began = time.monotonic()
        loop.errors(loop.levels(values), checking)
        pace = max(time.monotonic() - began, TICK) / len(checking)
        left = (limit / count - texels) / pace - judged * len(checking)
        every = math.ceil(learned / left) if left > 0 else math.inf
        if every > _WIDEST:
            return replace(rounds, count=0)
        chosen = _thinned(learning, int(every))
        renders = learned * len(chosen) / len(learning) + judged * len(checking)
        seconds = count * (texels + pace * renders)
        return replace(rounds, learning=chosen, judging=[*chosen, *checking], seconds=seconds)

    def run(self, values: Array) -> tuple[Array, int]:
        """The values after all rounds, and how many rounds there were: none follows one that changes nothing. A level
        that gains nothing stays bit for bit."""
        for done in range(self.count):
            numbers, matrix, right = self._equations(values)
            if not right.any():
                return values, done
            variants = [values]
            for damping in _DAMPINGS:
                for alone in (False, True):
                    variants.append(self._stepped(values, numbers, matrix, right, damping, alone))
            chosen = self.loop.chosen(variants, self.judging)
            if not chosen.any():
                return values, done
            values = self.loop.parameters.joined(variants, chosen)
        return values, self.count

    def numbers(self, values: Array, level: int) -> list[Number]:
        """The numbers of a level. There is none that moves nothing."""
        parameters = self.loop.parameters
        steps = np.asarray(parameters.channels.magnitude)  # 0 for what follows from other channels
        found = []
        for each in parameters.model.maps.values():
            own = [index for index in range(each.start, each.stop) if steps[index] > 0]
            found += [Number(level, [index], _DIFFERENCE * float(steps[index])) for index in own]
            for toward in range(_MEAN, len(self.others)):
                distance = self._moves(values, Number(level, own, 1.0, toward), self._some(level))
                size = float(np.sqrt(np.square(distance / steps[own]).sum(-1).mean()))
                if size > 1e-3:  # quantisation steps; less is rounding
                    found.append(Number(level, own, _DIFFERENCE / size, toward))
        return found

    def moved(self, values: Array, level: int, numbers: Sequence[Number], by: Sequence[float]) -> Array:
        """(texels of the level, channels) of these values, with numbers of the level moved, within the limits."""
        channels, own = self.loop.parameters.channels, self.loop.parameters.texels(level)
        moved: Array = values[own].copy()
        for number, amount in zip(numbers, by, strict=True):
            moved[:, number.channels] += amount * self._moves(values, number, own)
        np.clip(moved, np.asarray(channels.low, np.float32), np.asarray(channels.high, np.float32), out=moved)
        still = replace(channels, magnitude=tuple(0.0 for _ in channels.magnitude))
        return np.asarray(stochastic.perturb(moved, still, 0, 0)[0])  # with normals of unit length

    def _reached(self, values: Array, number: Number, by: float) -> float:
        """How much of the sum of squares of a move the limits of channels leave, from 0 to 1; 1 of no move."""
        channels, some = self.loop.parameters.channels, self._some(number.level)
        before = values[some][:, number.channels].astype(np.float64)
        wanted = by * self._moves(values, number, some).astype(np.float64)
        low, high = (np.asarray(limit)[number.channels] for limit in (channels.low, channels.high))
        energy = float(np.square(wanted).sum())
        return float(np.square(np.clip(before + wanted, low, high) - before).sum()) / energy if energy > 0 else 1.0

    def _moves(self, values: Array, number: Number, texels: slice) -> Array:
        """(texels, channels of the number) how far texels of its level move where it grows by 1."""
        own: Array = values[texels][:, number.channels]
        if number.toward is None:
            return np.full_like(own, number.factor)
        if number.toward == _MEAN:
            mean = values[self._some(number.level)][:, number.channels].mean(0, dtype=np.float64)
            return np.asarray((own - mean.astype(np.float32)) * np.float32(number.factor))
        other = self.others[number.toward][texels][:, number.channels]
        return np.asarray((other - own) * np.float32(number.factor))

    def _some(self, level: int) -> slice:
        own = self.loop.parameters.texels(level)
        return slice(own.start, own.stop, -(-(own.stop - own.start) // _SAMPLED))

    def _equations(self, values: Array) -> tuple[list[Number], NDArray[np.float64], NDArray[np.float64]]:
        """The numbers, and normal equations of least squares: matrix @ amounts = right where views are right to first
        order. Each view is rendered once for each number of a level that takes part in it."""
        loop, views = self.loop, self.learning
        numbers = [number for level in self.movable for number in self.numbers(values, level)]
        levels = np.array([number.level for number in numbers], np.int64)
        matrix, right = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
        takes_part = [view.shares[levels] >= _LEAST_SHARE for view in views]
        resting = loop.levels(values)
        pictures = [_thin(loop.compared(resting, view), view) for view in views]
        scratch = values.copy()
        for part in _parts([len(each) * int(own.sum()) for each, own in zip(pictures, takes_part, strict=True)]):
            columns: dict[int, list[Array]] = {index: [] for index in part if takes_part[index].any()}
            for at, number in enumerate(numbers):
                seen = [index for index in columns if takes_part[index][at]]
                if not seen:
                    continue
                # To the side that limits leave free: what lies at a limit can move away from it alone.
                side = 1.0 if self._reached(values, number, 1.0) >= self._reached(values, number, -1.0) else -1.0
                own = loop.parameters.texels(number.level)
                scratch[own] = self.moved(values, number.level, [number], [side])
                moved = loop.levels(scratch, loop.stamps.level(number.level))
                for index in seen:
                    picture = _thin(loop.compared(moved, views[index]), views[index])
                    columns[index].append((side * (picture - pictures[index])).ravel())
                scratch[own] = values[own]
            for index, derivatives in columns.items():
                every, among = np.stack(derivatives), np.flatnonzero(takes_part[index])
                missing = _thin(views[index].wanted, views[index]) - pictures[index]
                matrix[np.ix_(among, among)] += every @ every.T
                right[among] += every @ missing.ravel()
        return numbers, matrix, right

    def _stepped(
        self,
        values: Array,
        numbers: Sequence[Number],
        matrix: NDArray[np.float64],
        right: NDArray[np.float64],
        damping: float,
        alone: bool,
    ) -> Array:
        """The values after a damped step.

        Where levels move `alone`, no number moves them towards other stacks: fewer numbers follow views that were
        learned from less closely. A number that limits of channels would stop stays where it is, and the others make up
        for it: a metallic map of 0 cannot fall, for one.
        """
        scale = np.diag(matrix)
        damped = matrix + np.diag(damping * scale + _FLOOR * scale.mean())
        to_others = np.array([number.toward is not None and number.toward != _MEAN for number in numbers])
        moving = (scale > 0) & ~(alone & to_others)
        while True:
            found = np.zeros(len(right))
            found[moving] = np.linalg.solve(damped[np.ix_(moving, moving)], right[moving])
            reached = [self._reached(values, *each) for each in zip(numbers, found.tolist(), strict=True)]
            stopped = np.array(reached) < _STOPPED
            if not stopped.any():
                break
            moving &= ~stopped
        stepped: Array = values.copy()
        for level in {number.level for number in numbers}:
            own = [index for index, number in enumerate(numbers) if number.level == level]
            moved = self.moved(values, level, [numbers[index] for index in own], found[own].tolist())
            stepped[self.loop.parameters.texels(level)] = moved
        return stepped


def _thinned(views: Sequence[Prepared], every: int) -> list[Prepared]:
    """Every so-manieth view of each scale, the first of each among them."""
    counts: Counter[str] = Counter()
    kept = []
    for view in views:
        if counts[view.scale] % every == 0:
            kept.append(view)
        counts[view.scale] += 1
    return kept


def _thin(picture: Array, view: Prepared) -> Array:
    """Some of the pixels (P, 6), and 0 for those that do not count."""
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
    yield part
