"""A search, and its stages: ingredients are gathered and a stack is made of them; its texels are optimised, held by
what the stack is known to be worth; and of that is kept what renders that nothing was fitted to confirm."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from mipbake.baking.prefilter import say
from mipbake.baking.search.blending import Blend, between, confirmed
from mipbake.baking.search.checkpoint import Checkpoint, Windows, start_of
from mipbake.baking.search.forecast import FEWEST, Forecast
from mipbake.baking.search.ingredients import Bench, Ingredient
from mipbake.baking.search.long_run import NOT_KEPT, LongRun
from mipbake.baking.search.regions import timed_regions, window
from mipbake.baking.search.texel_descent import Descent, DescentEffort, descend
from mipbake.base import memory
from mipbake.base.messages import time_text
from mipbake.base.timings import Progress
from mipbake.material import directions
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.pairs import SET_SIZE
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import DECIBEL, Score
from mipbake.quality.judging.terms import TERMS, Array, Term, Weights, standard_error
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Image, Problem
from mipbake.stack.measured import Looks, Measured, MeasuredLevel

_CHECKING = 0.04  # share of the time left after the blend, for judging what was gained
_SOLVED_DB = 60.0  # SNR from which a level is left alone: its error is far below what 8 bits resolve


@dataclass(frozen=True)
class Plan:
    """What a method does.

    Args:
        start: makes the stack that texels are optimised from: `blending.blend` or `blending.best`.
        effort: of the descent on each region; None where there is none.
        trust: rounds that the start is worth: it holds texels as so many past rounds would.
    """

    start: Callable[[Bench], Blend]
    effort: DescentEffort | None
    trust: float = 0.0

    @property
    def gathering(self) -> float:
        """Share of the work that ingredients are, for progress; a guess."""
        return 0.95 if self.effort is None else 0.1


@dataclass(eq=False)
class Search:
    """A search: what it is for, and how far it has come.

    Args:
        effort: of the renders that judge. judged_by: what errors count. seed: of all that is drawn.
        progress: takes the finished share of the work, and notes.
        long_run: who may stop a descent, and what takes notes of it. checkpoint: what it is kept in; None for nothing.
        seconds: that it may take; infinite for no limit. began: time.monotonic() when it began.
        start: a stack made of the ingredients.
        levels: what became of it. kept: how much of each level's change was kept. seen: as a Blend has it, of `levels`.
        done: regions that an earlier run of the program has optimised, by their indices.
        stopped: whether somebody stopped it before it was done.
    """

    problem: Problem
    effort: ProbeEffort
    judged_by: Weights
    seed: int = 0
    progress: Progress = lambda _: None
    long_run: LongRun = NOT_KEPT
    checkpoint: Checkpoint | None = None
    seconds: float = math.inf
    began: float = field(default_factory=time.monotonic)
    start: Blend = field(init=False)
    levels: list[Image] = field(init=False)
    kept: list[float] = field(init=False)
    seen: list[Array] = field(init=False)
    done: frozenset[int] = frozenset()
    stopped: bool = False

    def begin(self, ingredients: Sequence[Ingredient], plan: Plan) -> None:
        """Goes on from the checkpoint; without one, looks the ingredients up and makes a stack of them."""
        begun = partial(start_of, problem=self.problem, effort=self.effort, judged_by=self.judged_by, seed=self.seed)
        found = None if self.checkpoint is None else self.checkpoint.load(begun)
        if self.checkpoint is None or found is None:
            self._begin_with(self._made(ingredients, plan))
            return
        kept, start = found
        spent = time_text(kept.seconds) + ("" if math.isinf(self.seconds) else f" of {time_text(self.seconds)}")
        self.long_run.note(f"going on from the checkpoint {self.checkpoint.path}, after {spent}")
        self._begin_with(start)
        self.levels, self.done = kept.levels, kept.done
        self.began -= kept.seconds

    def _made(self, ingredients: Sequence[Ingredient], plan: Plan) -> Blend:
        """A stack made of ingredients, whose lookups, hundreds of megabytes, nothing after this needs."""
        share = plan.gathering
        bench = Bench(
            self.problem, ingredients, self.effort, self.judged_by, self.seed, lambda done: self.progress(share * done)
        )
        return plan.start(bench)

    def _begin_with(self, start: Blend) -> None:
        self.start, self.levels, self.kept = start, start.levels, [0.0] * len(start.levels)
        self.seen = start.seen

    @cached_property
    def before(self) -> list[Score]:
        """What the judge's renders say of the start."""
        return self.start.check.of_stack(self.start.levels)

    def descend(self, plan: Plan) -> None:
        """Optimises texels, from the coarsest levels on (texel_descent.py), until the time is over.

        Each region has a share of the time. Where a region would get so little that a round or two is all, its levels
        stay as they are, and the other regions have its time.
        """
        problem, start, last, effort = self.problem, self.start, self.problem.last, plan.effort
        if effort is None:
            return
        timed = not math.isinf(self.seconds)
        moving = [bool(score.decibels.min() < _SOLVED_DB) for score in self.before]
        every = list(timed_regions(problem, effort.window, effort.coarse))
        todo = [index for index, each in enumerate(every) if any(moving[i] for i in each.region.levels)]
        moved = {i for index in todo for i in every[index].region.levels}
        self.levels = [
            memory.copied(level) if i in moved and level is start.levels[i] else level
            for i, level in enumerate(self.levels)
        ]
        descent = Descent(problem, moving, effort, plan.trust, self.judged_by, start.typical)
        end = self.began + self.seconds
        if timed:
            end -= _CHECKING * max(0.0, end - time.monotonic())
        ahead = [index for index in todo if index not in self.done]
        forecast = Forecast(problem, effort, every, ahead, self.began, self.seconds, end, self.long_run.note)
        total, done, seconds = sum(every[index].share for index in todo), dict[int, Windows](), self._spent

        def keep(now: bool = False) -> None:
            if self.checkpoint is not None:
                self.checkpoint.keep(start, self.levels, done, seconds, now)

        with self.long_run.descending() as stop:
            if ahead:
                keep()
            for turn, index in enumerate(todo):
                if index in self.done:
                    continue
                self.stopped = stop()
                if self.stopped:
                    break
                here, now = every[index], time.monotonic()
                after = [each for each in todo[turn + 1 :] if each not in self.done]
                share = max(0.0, end - now) * here.share / sum(every[each].share for each in (index, *after))
                until = now + share if timed else math.inf
                if timed and share <= FEWEST * forecast.round_seconds(index):
                    continue
                passed, levels = sum(every[each].share for each in todo[:turn]) / total, here.region.levels
                place = f"level {levels.start}" + (f" to {last}" if levels.stop > last else "")
                forecast.begun(index, until)
                _, self.stopped = descend(
                    descent,
                    self.levels,
                    here.region,
                    np.random.default_rng([self.seed, 3, turn]),
                    until,
                    partial(self._progress_of_descent, plan, passed, here.share / total),
                    partial(self._note_of_descent, place),
                    stop,
                    partial(forecast.worked, todo=after),
                )
                if self.stopped:
                    break
                done[index] = {level: window(here.region, problem.sizes[level]) for level in levels}
                seconds = self._spent
                keep()
        if self.stopped:
            keep(now=True)

    @property
    def _spent(self) -> float:
        """Seconds since it began, in all runs of the program."""
        return time.monotonic() - self.began

    def _progress_of_descent(self, plan: Plan, passed: float, part: float, share: float) -> None:
        self.progress(plan.gathering + (1 - plan.gathering) * min(0.99, passed + share * part))

    def _note_of_descent(self, place: str, text: str) -> None:
        say(self.progress, f"{place}: {text}")

    def keep(self) -> None:
        """Keeps of every level's change as much as the judge confirms, against the start."""
        start, target = self.start, self.problem.target
        both = list(zip(start.levels, self.levels, strict=True))
        changed = [first is not second and not np.array_equal(first, second) for first, second in both]
        if not any(changed):
            self.levels = start.levels
            return

        def texels(level: int, kept: float) -> Image:
            first, second = (start.check.looked_up(each, level) for each in both[level])
            return between(first, second, kept, target)

        # Nothing becomes worse than the start, which itself was held against every closed form that looks fine.
        baselines = [
            Baseline({name: _allowed(term, before.values[name], score) for name, term in TERMS.items()}, before.plain)
            for before, score in zip(start.judge.baselines, self.before, strict=True)
        ]
        found = confirmed(Judge(baselines, self.judged_by), start.check, texels)
        kept, self.seen = [share for share, _ in found], [score.visible for _, score in found]
        self.kept = [share if moved else 0.0 for share, moved in zip(kept, changed, strict=True)]
        levels = [_level_between(*each, share, target) for each, share in zip(both, self.kept, strict=True)]
        self.levels = directions.aligned(levels, target, self.problem.wrap)

    def measured(self) -> Measured:
        """What held-out renders say of every level."""
        start = self.start
        found = start.held_out.of_stack(self.levels)
        levels = []
        for level, (score, rivals) in enumerate(zip(found, start.rivals, strict=True)):
            rows, others = score.log_errors, rivals.log_errors
            levels.append(
                MeasuredLevel(
                    _by_set(-DECIBEL * rows.mean(1)),
                    _by_set(DECIBEL * standard_error(rows)),
                    dict(zip(PAIR_SETS, rivals.names, strict=True)),
                    _by_set(-DECIBEL * others.mean(1)),
                    _by_set(DECIBEL * standard_error(rows - others)),
                    level,
                    start.sources[level],
                    self.kept[level],
                    _looks(self.seen[level], start.plain[level], score.decibels - start.plain_decibels[level]),
                )
            )
        effort = start.held_out.effort
        pairs, points = effort.groups * SET_SIZE, effort.groups * effort.points
        visible = float(np.exp(np.mean([score.visible.mean(-1) for score in found] - start.plain_held_out)))
        return Measured(tuple(levels), pairs, points, round(visible, 4))


def _by_set(values: Array) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in zip(PAIR_SETS, values, strict=True)}


def _looks(seen: Array, plain: Array, gain: Array) -> Looks:
    """Of (V, N) values whose mean is the logarithm of the square of a visible error, and (S,) gains in decibels."""
    error = math.sqrt(np.square(standard_error(seen - plain)).sum()) / 2 / len(seen)
    own, other = (math.exp(each.mean() / 2) for each in (seen, plain))
    return Looks(round(own, 5), round(other, 5), round(error, 5), _by_set(gain))


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
