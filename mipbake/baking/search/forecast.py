"""How long a descent will take, and how far its budget reaches, from how long its rounds took so far."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from mipbake.baking.search.pixel_samples import samples_at
from mipbake.baking.search.regions import TimedRegion
from mipbake.baking.search.texel_descent import DescentEffort, pixels_of_round, renders_of_pixel
from mipbake.base.messages import time_text
from mipbake.quality.reference.problem import Problem

FEWEST = 3
"""Rounds that are worth beginning with a region."""

_SECONDS, _SHARE = 10.0, 0.1  # of descending, or of the budget, after which a forecast is made
_OTHER = 1.5  # factor by which a forecast must have been wrong to be given again
# What a round costs, in renders of a pixel. Measured once for a set of 1024 texels a side, and held to no record: a
# reference sample of a render costs so much, and the pictures of a level as much as so many renders.
_SAMPLE, _PICTURES = 1 / 35, 4e5
_BEGINNING = 1.0  # rounds that take as long as what comes before the first round of a region; measured as the above


def cost_of_round(problem: Problem, timed: TimedRegion, effort: DescentEffort) -> float:
    """What a round of a region costs, in renders of a pixel."""
    total = 0.0
    for level in timed.region.levels:
        pixels = pixels_of_round(problem, timed.region, level)
        renders = pixels * renders_of_pixel(level, pixels, effort.pairs)
        total += renders * (1 + _SAMPLE * samples_at(level, effort.samples)) + _PICTURES
    return total


class Forecast:
    """Follows a descent, and says once what is ahead; again where that turns out to be wrong.

    Args:
        problem, effort: of the descent. regions: all of them. todo: indices of regions to work on, in their order.
        began: time.monotonic() when the search began. seconds: its limit of time; infinite for none.
        end: time.monotonic() when the descent has to end. note: takes the sentence.
    """

    def __init__(
        self,
        problem: Problem,
        effort: DescentEffort,
        regions: Sequence[TimedRegion],
        todo: Sequence[int],
        began: float,
        seconds: float,
        end: float,
        note: Callable[[str], None],
    ) -> None:
        self._costs = [cost_of_round(problem, timed, effort) for timed in regions]
        self._regions, self._rounds = regions, effort.rounds
        self._began, self._seconds, self._end, self._note = began, seconds, end, note
        self._start = time.monotonic()
        # What rounds cost, and how long they took, but for the first round of each region: what comes before it takes
        # longer in the first region than in all others.
        self._spent, self._taken = 0.0, 0.0
        self._last: float | None = None
        self._todo = [self._costs[index] for index in todo]
        self._announced: float | None = None  # the pace of the last forecast

    def begun(self, index: int, until: float) -> None:
        """A region was begun; it ends at a time.monotonic()."""
        self._until = until
        self._index, self._done, self._last = index, 0, None

    def worked(self, rounds: int, todo: Sequence[int]) -> None:
        """So many rounds of the region have been worked; `todo`: regions after it."""
        now, last = time.monotonic(), self._last
        if last is not None:
            self._spent += (rounds - self._done) * self._costs[self._index]
            self._taken += now - last
        self._done, self._last = rounds, now
        if not self._taken or now - self._start < min(_SECONDS, _SHARE * self._seconds):
            return
        pace = self._taken / self._spent
        if self._announced is None or not 1 / _OTHER < pace / self._announced < _OTHER:
            self._note(self._sentence(todo, pace, now))
            self._announced = pace

    def round_seconds(self, index: int) -> float:
        """How long a round of a region takes; 0 where nothing is known yet."""
        return self._costs[index] * self._taken / self._spent if self._spent else 0.0

    def _sentence(self, todo: Sequence[int], pace: float, now: float) -> str:
        """What is ahead, where a unit of cost takes `pace` seconds."""
        regions = [(self._index, self._rounds - self._done), *((index, self._rounds) for index in todo)]
        total = sum((rounds + _BEGINNING) * self._costs[index] * pace for index, rounds in regions)
        total -= _BEGINNING * self._costs[self._index] * pace  # the region at work has begun
        every = f"all {self._rounds} rounds of every level"
        if math.isinf(self._seconds):
            return (
                f"{every} would take about {time_text(total)} from now: the search takes at most so long, and less "
                "where nothing moves any more"
            )
        reached = self._reached(regions, pace, now)
        if reached > self._rounds - 1:
            return f"the budget reaches {every}, which take at most about {time_text(total)} from now"
        whole = time_text(self._start - self._began + (self._rounds + _BEGINNING) * sum(self._todo) * pace)
        reach = f"about {reached:.0f} of {self._rounds} rounds" if reached >= 0.5 else "no rounds"
        return f"the budget reaches {reach} of level 0: {every} would take a budget of about {whole}"

    def _reached(self, regions: Sequence[tuple[int, int]], pace: float, now: float) -> float:
        """Rounds of level 0 that there is time for, the mean over its windows, of what is left of each region."""
        reached, left = [], max(0.0, self._end - now)
        for turn, (index, rounds) in enumerate(regions):
            one = self._costs[index] * pace
            share = self._regions[index].share / sum(self._regions[each].share for each, _ in regions[turn:])
            given = left * share if turn else max(0.0, self._until - now)
            before = _BEGINNING if turn else 0.0
            count = 0.0 if turn and given <= FEWEST * one else min(float(rounds), max(0.0, given / one - before))
            left -= (count + before) * one if count else 0.0
            if self._regions[index].region.levels.start == 0:
                reached.append(count + (0 if turn else self._done))
        return sum(reached) / max(1, len(reached))
