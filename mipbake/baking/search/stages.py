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
from mipbake.baking.search.blending import Blend, Gathered, between, confirmed, gathered
from mipbake.baking.search.checkpoint import Checkpoint, Windows, start_of
from mipbake.baking.search.forecast import FEWEST, Forecast
from mipbake.baking.search.ingredients import Ingredient
from mipbake.baking.search.long_run import NOT_KEPT, LongRun, time_text
from mipbake.baking.search.regions import COARSE, TimedRegion, timed_regions, window
from mipbake.baking.search.texel_descent import Descent, DescentEffort, descend
from mipbake.base import memory
from mipbake.material import directions
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Score
from mipbake.quality.judging.terms import TERMS, Array, Term
from mipbake.quality.judging.weights import Weights
from mipbake.quality.reference.problem import Image, Problem

# Most of the time that ingredients take; in a large set, an ingredient that takes longer is left out.
_BAKING = 0.75
_CHECKING = 0.04  # share of the time left after the blend, for judging what was gained
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
        progress: takes the finished share of all stages, and notes.
        judged_by: what errors count.
        long_run: who may stop a descent, and what takes notes of it.
        checkpoint: what the search is kept in; None for nothing.
    """

    problem: Problem
    ingredients: Sequence[Ingredient]
    seed: int
    clock: Clock
    progress: Progress
    judged_by: Weights
    long_run: LongRun = NOT_KEPT
    checkpoint: Checkpoint | None = None


@dataclass(frozen=True, eq=False)
class Search:
    """A search as far as it has come.

    Args:
        gathered: the ingredients. start: a stack made of them. levels: what became of it.
        before: what the judge's renders say of the start. kept: how much of each level's change was kept.
        done: regions that an earlier run of the program has optimised, by their indices.
        stopped: whether somebody stopped it before it was done.
    """

    work: Work
    gathered: Gathered | None = None
    start: Blend | None = None
    before: list[Score] = field(default_factory=list)
    levels: list[Image] = field(default_factory=list)
    kept: list[float] = field(default_factory=list)
    done: frozenset[int] = frozenset()
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
"""Takes a search farther, and a progress of its own, from 0 to 1, beside the search's."""


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
            enough = time_text((ready - work.clock.began) / _BAKING)
            work.long_run.note(
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

    def __call__(self, search: Search, progress: Progress) -> Search:
        """See Stage."""
        work, start = search.work, search.blend
        problem, last = work.problem, work.problem.last
        worst = np.array([score.decibels.min() for score in search.before])
        moving = [bool((worst[max(0, 2 * i - 1) : 2 * i + 2] < _SOLVED_DB).any()) for i in range(last + 1)]
        every = list(timed_regions(problem, self.effort.window, self.fine, self.coarse))
        todo = [index for index, timed in enumerate(every) if any(moving[i] for i in timed.region.levels)]
        moved = {i for index in todo for i in every[index].region.levels}
        levels = [
            memory.copied(level) if i in moved and level is start.levels[i] else level
            for i, level in enumerate(search.levels)
        ]
        descent = Descent(problem, moving, self.effort, self.trust, work.judged_by, start.typical)
        end = work.clock.until(1.0)
        if work.clock.timed:
            end -= _CHECKING * max(0.0, end - time.monotonic())
        total, stopped = sum(every[index].share for index in todo), False
        ahead = [index for index in todo if index not in search.done]
        forecast = Forecast(
            problem, self.effort, every, ahead, work.clock.began, work.clock.seconds, end, work.long_run.note
        )
        done: dict[int, Windows] = {}
        seconds = time.monotonic() - work.clock.began

        def keep(now: bool = False) -> None:
            if work.checkpoint is not None:
                work.checkpoint.keep(start, levels, done, seconds, now)

        with work.long_run.descending() as stop:
            if ahead:
                keep()
            for turn, index in enumerate(todo):
                if index in search.done:
                    continue
                stopped = stop()
                if stopped:
                    break
                timed, now = every[index], time.monotonic()
                after = [each for each in todo[turn + 1 :] if each not in search.done]
                share = max(0.0, end - now) * timed.share / sum(every[each].share for each in (index, *after))
                until = now + share if work.clock.timed else math.inf
                if work.clock.timed and share <= FEWEST * forecast.round_seconds(index):
                    continue
                passed = sum(every[each].share for each in todo[:turn]) / total
                shown = _RegionProgress(progress, work.progress, timed, passed, total, last)
                rng = np.random.default_rng([work.seed, 3, turn])
                worked = partial(forecast.worked, todo=after)
                forecast.begun(index, until)
                _, stopped = descend(descent, levels, timed.region, rng, until, shown, stop, worked)
                if stopped:
                    break
                done[index] = {level: window(timed.region, problem.sizes[level]) for level in timed.region.levels}
                seconds = time.monotonic() - work.clock.began
                keep()
        if stopped:
            keep(now=True)
        return replace(search, levels=levels, stopped=stopped)


def resumed(work: Work, effort: ProbeEffort) -> Search:
    """A search from where its checkpoint has it, or from the beginning.

    Args:
        effort: of the renders that judge, as `Gather` has it.
    """
    kept = None if work.checkpoint is None else work.checkpoint.load()
    if work.checkpoint is None or kept is None:
        return Search(work)
    spent = time_text(kept.seconds) + (f" of {time_text(work.clock.seconds)}" if work.clock.timed else "")
    work.long_run.note(f"going on from the checkpoint {work.checkpoint.path}, after {spent}")
    start = start_of(kept, work.problem, effort, work.judged_by, work.seed)
    before = start.check.of_stack(start.levels)
    work = replace(work, clock=replace(work.clock, began=work.clock.began - kept.seconds))
    return Search(work, None, start, before, kept.levels, _none(start), kept.done)


def _none(start: Blend) -> list[float]:
    """That nothing is kept of any change."""
    return [0.0] * len(start.levels)


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
        place = f"level {levels.start}" + (f" to {self.last}" if levels.stop > self.last else "")
        say(self.search, f"{place}: {text}")


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
        baselines = [
            Baseline({name: _allowed(term, before.values[name], score) for name, term in TERMS.items()}, before.plain)
            for before, score in zip(start.judge.baselines, search.before, strict=True)
        ]
        kept = confirmed(Judge(baselines, search.work.judged_by), check, texels, len(changed))
        kept = [share if moved else 0.0 for share, moved in zip(kept, changed, strict=True)]
        levels = [_level_between(*each, share, problem.target) for each, share in zip(both, kept, strict=True)]
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


def _allowed(term: Term, before: Array, start: Score) -> Array:
    """(N,) values of a term that must not become worse: of the start or, of pictures, the baseline that it was held
    against, whichever is worse."""
    own = term.values(start)
    return before if term.visible and before.mean() > own.mean() else own
