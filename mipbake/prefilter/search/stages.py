"""The stages of a search: each takes a search as far as it has come, and gives it back farther.

Ingredients are gathered; levels are made of them; texels are optimised, with what the levels are known to be worth to
hold them; and of that is kept what renders that nothing was fitted to confirm.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mipbake import directions, memory
from mipbake.judging.judge import Asked, Judge
from mipbake.judging.probes import ProbeEffort
from mipbake.judging.scores import Array, Score
from mipbake.judging.weights import Weights
from mipbake.prefilter.base import Progress, say
from mipbake.prefilter.search.blending import Blend, Gathered, gathered
from mipbake.prefilter.search.descent_effort import DescentEffort
from mipbake.prefilter.search.ingredients import Ingredient
from mipbake.prefilter.search.regions import COARSE, TimedRegion, timed_regions
from mipbake.prefilter.search.settling import between, settle
from mipbake.prefilter.search.texel_descent import Descent, descend
from mipbake.reference.problem import Image, Problem

# Most of the time that ingredients take; in a large set, an ingredient that takes longer is left out; a guess.
_BAKING = 0.75
_SETTLING = 0.04  # share of the time left after the blend, for judging what was gained; a guess
_FEWEST = 3  # rounds that are worth beginning with a region; a guess
_SOLVED_DB = 60.0  # SNR from which a level is left alone: its error is far below what 8 bits resolve; a guess


@dataclass(frozen=True)
class Clock:
    """When a search began, and how long it may take; infinite for no limit."""

    began: float
    seconds: float

    @property
    def timed(self) -> bool:
        """Whether there is a limit."""
        return not math.isinf(self.seconds)

    def until(self, share: float) -> float:
        """time.monotonic() at which a share of the time is over."""
        return self.began + share * self.seconds


@dataclass(frozen=True)
class Work:
    """What a search is for.

    Args:
        ingredients: the ingredients.
        seed: of all that is drawn.
        progress: told the finished share of all stages, and notes.
        judged_by: what errors count.
    """

    problem: Problem
    ingredients: Sequence[Ingredient]
    seed: int
    clock: Clock
    progress: Progress
    judged_by: Weights


@dataclass(frozen=True, eq=False)
class Search:
    """A search as far as it has come.

    Args:
        gathered: the ingredients. start: a stack made of them. levels: what became of it.
        before: what the judge's renders say of the start. kept: how much of each level's change was kept.
    """

    work: Work
    gathered: Gathered | None = None
    start: Blend | None = None
    before: list[Score] = field(default_factory=list)
    levels: list[Image] = field(default_factory=list)
    kept: list[float] = field(default_factory=list)

    @property
    def blend(self) -> Blend:
        """The start, which a stage before must have made."""
        if self.start is None:
            raise AssertionError("no stage has made a stack yet")
        return self.start

    @property
    def ingredients(self) -> Gathered:
        """The ingredients, which a stage before must have gathered."""
        if self.gathered is None:
            raise AssertionError("no stage has gathered ingredients yet")
        return self.gathered


Stage = Callable[[Search, Progress], Search]
"""Takes a search farther; is told progress of its own, from 0 to 1, beside the search's."""


@dataclass(frozen=True)
class Gather:
    """Bakes the ingredients, and looks them up in renders."""

    effort: ProbeEffort

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage."""
        work = search.work
        deadline = work.clock.until(_BAKING)
        found = gathered(work.problem, work.ingredients, self.effort, work.judged_by, work.seed, progress, deadline)
        return replace(search, gathered=found)


@dataclass(frozen=True)
class Make:
    """Levels made of the ingredients, by `blending.blend` or `blending.best`."""

    way: Callable[[Gathered], Blend]

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage."""
        start = self.way(search.ingredients)
        before = start.check.of_stack(start.levels)
        progress(1.0)
        # Nothing after this needs ingredients, whose lookups are hundreds of megabytes.
        none = [0.0] * len(start.levels)
        return replace(search, gathered=None, start=start, before=before, levels=start.levels, kept=none)


@dataclass(frozen=True)
class Descend:
    """Texels optimised from the coarsest levels on (texel_descent.py), until the time is over.

    Each region has a share of the time. Where a region would get so little that a round or two is all, its levels stay
    as they are, and the other regions have its time.

    Args:
        effort: on a region.
        fine: whether levels of more than `coarse` texels a side take part.
        trust: rounds that the start is worth: it holds texels as so many past rounds would.
    """

    effort: DescentEffort
    fine: bool
    trust: float
    coarse: int = COARSE

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage."""
        work = search.work
        problem, last = work.problem, work.problem.last
        worst = np.array([score.decibels.min() for score in search.before])
        moving = [bool((worst[max(0, 2 * i - 1) : 2 * i + 2] < _SOLVED_DB).any()) for i in range(last + 1)]
        todo = [
            timed
            for timed in timed_regions(problem, self.effort.window, self.fine, self.coarse)
            if any(moving[i] for i in timed.region.levels)
        ]
        moved = {i for timed in todo for i in timed.region.levels}
        levels = [memory.copied(level) if i in moved else level for i, level in enumerate(search.levels)]
        typical = search.blend.typical
        descent = Descent(problem, moving, self.effort, self.trust, work.judged_by, typical) if todo else None
        end = work.clock.until(1.0)
        if work.clock.timed:
            end -= _SETTLING * max(0.0, end - time.monotonic())
        total, done = sum(timed.share for timed in todo), 0.0
        pace = 0.0  # seconds that a round takes for a texel
        for index, timed in enumerate(todo):
            now, texels = time.monotonic(), timed.texels(problem)
            rest = sum(each.share for each in todo[index:])
            until = now + max(0.0, end - now) * timed.share / rest if work.clock.timed else math.inf
            if descent is not None and not (work.clock.timed and until - now <= _FEWEST * pace * texels):
                rounds = descend(
                    descent,
                    levels,
                    timed.region,
                    np.random.default_rng([work.seed, 3, index]),
                    until,
                    _RegionProgress(progress, work.progress, timed, done / total, total, last),
                )
                pace = (time.monotonic() - now) / max(1, rounds) / texels
            done += timed.share
        return replace(search, levels=levels)


@dataclass(frozen=True)
class _RegionProgress:
    """Progress and notes of the descent in a region, as the search's."""

    stage: Progress
    search: Progress
    timed: TimedRegion
    done: float
    total: float
    last: int

    def __call__(self, share: float) -> None:
        self.stage(min(0.99, self.done + share * self.timed.share / self.total))

    def note(self, text: str) -> None:
        levels = self.timed.region.levels
        spoken = f"level {levels.start}" + (f" to {self.last}" if levels.stop > self.last else "")
        say(self.search, f"{spoken}: {text}")


@dataclass(frozen=True)
class Keep:
    """Of every level's change as much as the judge confirms, against the start."""

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage."""
        start, problem, cache = search.blend, search.work.problem, dict[tuple[int, int], tuple[Image, Image]]()
        both = list(zip(start.levels, search.levels, strict=True))
        changed = [first is not second and not np.array_equal(first, second) for first, second in both]
        if not any(changed):
            return replace(search, levels=start.levels)
        check = start.check

        def texels(index: int, level: int, kept: float) -> Image:
            if (index, level) not in cache:
                first, second = both[level]
                cache[index, level] = check.looked_up(first, index), check.looked_up(second, index)
            return between(*cache[index, level], kept, problem.target)

        # Nothing becomes worse than the start, which itself was held against every closed form that looks fine.
        asked = [
            Asked(score.log_errors, score.pooled, _worse(before.seen, score.seen), before.plain)
            for before, score in zip(start.judge.asked, search.before, strict=True)
        ]
        kept = settle(Judge(asked, search.work.judged_by), check, texels, len(changed))
        kept = [much if moved else 0.0 for much, moved in zip(kept, changed, strict=True)]
        levels = [_level_between(*each, much, problem.target) for each, much in zip(both, kept, strict=True)]
        progress(1.0)
        return replace(search, levels=directions.aligned(levels, problem.target, problem.wrap), kept=kept)


def _level_between(first: Image, second: Image, kept: float, model: str) -> Image:
    """`between` of a whole level, some rows at a time."""
    if first is second or kept in (0.0, 1.0):
        return second if kept else first
    out: Image = memory.empty(first.shape)
    for rows in memory.some_rows(out):
        out[rows] = between(first[rows], second[rows], kept, model)
    return out


def _worse(first: Array, second: Array) -> Array:
    """(V, N) of each kind the rows whose mean is higher."""
    return np.where((first.mean(-1) > second.mean(-1))[:, None], first, second)
