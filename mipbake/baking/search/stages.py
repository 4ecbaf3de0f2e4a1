"""The stages of a search: each takes a search as far as it has come, and gives it back farther.

Ingredients are gathered; levels are made of them; texels are optimised, with what the levels are known to be worth to
hold them; and of that is kept what renders that nothing was fitted to confirm.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from mipbake.baking.prefilter import Progress, say
from mipbake.baking.search.blending import Blend, Gathered, gathered
from mipbake.baking.search.checkpoint import Checkpoint
from mipbake.baking.search.descent_effort import DescentEffort
from mipbake.baking.search.forecast import FEWEST, Forecast
from mipbake.baking.search.ingredients import Ingredient
from mipbake.baking.search.keeping import Keeping, windows_in
from mipbake.baking.search.kept_search import Come, start_of
from mipbake.baking.search.regions import COARSE, TimedRegion, timed_regions
from mipbake.baking.search.settling import between, settle
from mipbake.baking.search.sitting import ONLY, Sitting, Stop, spoken_time
from mipbake.baking.search.texel_descent import Descent, RegionState, Watch, descend
from mipbake.base import memory
from mipbake.material import MODELS, directions
from mipbake.quality.judging.judge import Asked, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Array, Score
from mipbake.quality.judging.weights import Weights
from mipbake.quality.reference.problem import Image, Problem

# Most of the time that ingredients take; in a large set, an ingredient that takes longer is left out.
_BAKING = 0.75
_SETTLING = 0.04  # share of the time left after the blend, for judging what was gained
_SOLVED_DB = 60.0  # SNR from which a level is left alone: its error is far below what 8 bits resolve


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
        sitting: who may stop a descent, and who hears of it. checkpoint: what the search is kept in; None for nothing.
    """

    problem: Problem
    ingredients: Sequence[Ingredient]
    seed: int
    clock: Clock
    progress: Progress
    judged_by: Weights
    sitting: Sitting = ONLY
    checkpoint: Checkpoint | None = None


@dataclass(frozen=True, eq=False)
class Search:
    """A search as far as it has come.

    Args:
        gathered: the ingredients. start: a stack made of them. levels: what became of it.
        before: what the judge's renders say of the start. kept: how much of each level's change was kept.
        come: how far an earlier sitting has come with the levels; None where there was none.
        stopped: whether somebody stopped it before it was done.
    """

    work: Work
    gathered: Gathered | None = None
    start: Blend | None = None
    before: list[Score] = field(default_factory=list)
    levels: list[Image] = field(default_factory=list)
    kept: list[float] = field(default_factory=list)
    come: Come | None = None
    stopped: bool = False

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
        """See Stage. A search that goes on has a start already."""
        if search.start is not None:
            return search
        work = search.work
        deadline = work.clock.until(_BAKING)
        found = gathered(work.problem, work.ingredients, self.effort, work.judged_by, work.seed, progress, deadline)
        ready = found.bench.pressing
        if ready is not None:
            enough = spoken_time((ready - work.clock.began) / _BAKING)
            work.sitting.told(
                "the budget is too short to measure and to blend all ingredients, so some take no part: a budget of "
                f"about {enough} would do"
            )
        return replace(search, gathered=found)


@dataclass(frozen=True)
class Make:
    """Levels made of the ingredients, by `blending.blend` or `blending.best`."""

    way: Callable[[Gathered], Blend]

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage. A search that goes on has a start already."""
        if search.start is not None:
            return search
        start = self.way(search.ingredients)
        before = start.check.of_stack(start.levels)
        progress(1.0)
        # Nothing after this needs ingredients, whose lookups are hundreds of megabytes.
        return replace(search, gathered=None, start=start, before=before, levels=start.levels, kept=_none(start))


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

    def regions(self, problem: Problem) -> list[TimedRegion]:
        """All regions, those without anything to do as well."""
        return list(timed_regions(problem, self.effort.window, self.fine, self.coarse))

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage."""
        work, start = search.work, search.blend
        problem, last = work.problem, work.problem.last
        worst = np.array([score.decibels.min() for score in search.before])
        moving = [bool((worst[max(0, 2 * i - 1) : 2 * i + 2] < _SOLVED_DB).any()) for i in range(last + 1)]
        every = self.regions(problem)
        todo = [index for index, timed in enumerate(every) if any(moving[i] for i in timed.region.levels)]
        moved = {i for index in todo for i in every[index].region.levels}
        levels = [
            memory.copied(level) if i in moved and level is start.levels[i] else level
            for i, level in enumerate(search.levels)
        ]
        descent = Descent(problem, moving, self.effort, self.trust, work.judged_by, start.typical) if todo else None
        end = work.clock.until(1.0)
        if work.clock.timed:
            end -= _SETTLING * max(0.0, end - time.monotonic())
        come = search.come or Come((), -1)
        kept = Keeping(work.checkpoint, problem, start, every, levels, come, work.clock.began)
        total, stopped = sum(every[index].share for index in todo), False
        left = False  # whether the region at work is kept
        ahead = [index for index in todo if index not in kept.done]
        forecast = Forecast(
            problem, self.effort, every, ahead, work.clock.began, work.clock.seconds, end, work.sitting.told
        )
        with work.sitting.descending() as stop:
            for turn, index in enumerate(todo):
                if index in kept.done or descent is None:
                    continue
                stopped = stopped or stop()
                if stopped and index != kept.waiting:  # rounds that a sitting left are looked at all the same
                    continue
                timed, now, state = every[index], time.monotonic(), kept.taken(index)
                used = state.seconds if state else 0.0
                rest = sum(every[each].share for each in todo[turn:] if each not in kept.done)
                # What a region has used already is a part of what it gets.
                share = (max(0.0, end - now) + used) * timed.share / rest - used
                until = now + max(0.0, share) if work.clock.timed else math.inf
                if state is None and work.clock.timed and until - now <= FEWEST * forecast.round_seconds(index):
                    continue
                passed = sum(every[each].share for each in todo[:turn]) / total
                told = _RegionProgress(progress, work.progress, timed, passed, total, last)
                rng = np.random.default_rng([work.seed, 3, turn])
                after = [each for each in todo[turn + 1 :] if each not in kept.done]
                watch = _RegionWatch(kept, index, stop, forecast, after)
                forecast.begun(index, state.rounds if state else 0, until)
                descend(descent, levels, timed.region, rng, until, told, watch.made(state))
                if watch.was_left:
                    stopped = left = True
                    continue
                kept.done.add(index)
                kept.keep(index)
        if stopped and not left:
            kept.keep(-1, now=True)
        return replace(search, levels=levels, stopped=stopped)


def gone_on(work: Work, effort: ProbeEffort, descend: Descend) -> Search:
    """A search from where its checkpoint has it, or from the beginning.

    Args:
        effort: of the renders that judge, as `Gather` has it. descend: the stage that is kept.
    """
    checkpoint, problem = work.checkpoint, work.problem
    if checkpoint is None:
        return Search(work)
    shapes = [(*size, MODELS[problem.target].channels) for size in problem.sizes]
    kept = checkpoint.load(shapes, partial(windows_in, problem, descend.regions(problem)))
    if kept is None:
        return Search(work)
    spent = spoken_time(kept.seconds) + (f" of {spoken_time(work.clock.seconds)}" if work.clock.timed else "")
    work.sitting.told(f"going on from the checkpoint {checkpoint.path}, after {spent}")
    start = start_of(kept.start, problem, effort, work.judged_by, work.seed)
    before = start.check.of_stack(start.levels)
    work = replace(work, clock=replace(work.clock, began=work.clock.began - kept.seconds))
    return Search(work, None, start, before, kept.levels, _none(start), kept.come)


def _none(start: Blend) -> list[float]:
    """That nothing is kept of any change."""
    return [0.0] * len(start.levels)


@dataclass
class _RegionWatch:
    """Watches the descent in a region: keeps it, and tells whether it was left before it was done.

    Args:
        index: of the region. after: regions that come after it.
    """

    kept: Keeping
    index: int
    stop: Stop
    forecast: Forecast
    after: Sequence[int]
    was_left: bool = False

    def made(self, start: RegionState | None) -> Watch:
        """What the descent is given."""
        return Watch(start, self.stop, self._worked, self._left)

    def _worked(self, rounds: int, state: Callable[[], RegionState]) -> None:
        self.forecast.worked(rounds, self.after)
        if self.kept.due:
            self.kept.keep(self.index, state())

    def _left(self, state: RegionState | None) -> None:
        self.was_left = True
        self.kept.keep(self.index, state, now=True)


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
