"""`auto`, `refine` and `optimum`: three short lists of stages.

All gather ingredients and make levels of them. `auto` and `refine` start from the best blend, which costs seconds and
is better than any of its ingredients. From there texels are optimised one by one (texel_descent.py), held by what the
blend knows: so nothing is lost to noise in the first rounds, and a few rounds already gain. Coarse levels have few
texels and are seen from afar: they come first and cost next to nothing. `auto` stops there; `refine`, or `auto` with a
budget, goes on to the fine levels. `optimum` starts from the best closed form of each level, is held by nothing, and
shows the limit of a stack with a single lobe a texel.

In the end each level keeps of its change what independent renders confirm, against the start, which itself was held
against every closed form that looks fine. Held-out renders measure the result.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from mipbake.baking.neural import Neural
from mipbake.baking.prefilter import PrefilterResult, Progress
from mipbake.baking.search.blending import best, blend
from mipbake.baking.search.checkpoint import Checkpoint
from mipbake.baking.search.ingredients import Ingredient, closed_forms, ingredient
from mipbake.baking.search.long_run import NOT_KEPT, LongRun, seconds_of
from mipbake.baking.search.stages import Clock, Descend, Gather, Keep, Make, Search, Stage, Work, resumed
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.base import memory
from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError
from mipbake.base.threads import one_blas_thread
from mipbake.material.aim import DEFAULT_AIM, DEFAULT_SAMPLER, Sampler, checked_aim
from mipbake.material.pixel_filter import Wrap, filter_named
from mipbake.quality.judging.pairs import SET_SIZE
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import DECIBEL
from mipbake.quality.judging.terms import Array, standard_error
from mipbake.quality.judging.weights import SINGLE_LIGHTS, Weights, weights_for
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Image, Problem
from mipbake.stack.promise import Measured, MeasuredBetween, MeasuredLevel

REFINE_SECONDS = 120.0
"""Budget of `refine` where none is given."""

EFFORT = ProbeEffort()
REFINING = DescentEffort(rounds=60, looks=ProbeEffort(groups=8, points=96, pictures=16))
COARSE = DescentEffort(rounds=6, pairs=16, samples=4, looks=ProbeEffort(groups=4, points=48, samples=4, pictures=8))
"""Effort on coarse levels, where not all are refined: few rounds, held by the blend, which need no more. The numbers of
REFINING and COARSE are guesses."""

OPTIMISING = DescentEffort()

# Rounds that a blend is worth: measured against 4 and 50, after 6 rounds and after 24; no record holds the figures.
_TRUST = 12.0
_FIRST = 16  # texels a side of the first call of a network


@dataclass(frozen=True)
class Step:
    """A stage, and its share of the progress."""

    stage: Stage
    share: float


class Searching:
    """A method that is a list of stages.

    Args:
        weights: trained weights by name; None for the default ones, and without a network where there are none.
        budget: time as users write it (long_run.py); None for what is usual. Only without a limit of time are
            results reproducible.
        seed: seed of all that is drawn.
        effort: of the renders that judge. descent: effort on the levels; None for what is usual.
        judged_by: what errors count; None for what the aim says.
        sampler: that will look the stack up.
        aim: from 0, SNR under single lights, to 1, what people see in moving pictures.
        device: where the network runs (`Neural`); all else runs on the processor.
        long_run: who may stop a search that takes long, and where it is kept.
    """

    name: str
    summary: str
    averages = False
    own_memory = 1 << 30
    """The pictures and pixels that it measures with, and what ingredients show there; measured, for `auto`."""
    learned = True
    """Whether a network is among the ingredients."""
    usual_seconds: float | None = None
    aims = True
    """Whether an aim says what errors count, and stacks are made for a sampler that is chosen."""

    def __init__(
        self,
        weights: str | None = None,
        budget: str | None = None,
        seed: int = 0,
        effort: ProbeEffort = EFFORT,
        descent: DescentEffort | None = None,
        judged_by: Weights | None = None,
        sampler: Sampler = DEFAULT_SAMPLER,
        aim: float = DEFAULT_AIM,
        device: str = PROCESSOR,
        long_run: LongRun = NOT_KEPT,
    ) -> None:
        self.sampler, self.aim = sampler, checked_aim(aim)
        self._neural, self._named = Neural(weights, sampler, device), weights is not None
        self.budgeted = budget is not None
        self.seconds = self.usual_seconds if budget is None else seconds_of(budget)
        self._seed, self._effort, self._judged_by = seed, effort, judged_by or weights_for(self.aim)
        self._descent, self._device, self._long_run = descent, device, long_run

    @property
    def steps(self) -> Sequence[Step]:
        """The stages."""
        raise NotImplementedError

    @property
    def long(self) -> bool:
        """Whether it may take long enough to be stopped, kept and resumed."""
        return True

    def __call__(
        self, stored: Image, source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter. UsageError where named weights do not fit the target or the pixel filter."""
        clock = Clock(time.monotonic(), math.inf if self.seconds is None else self.seconds)
        filter_named(pixel_filter)
        problem = Problem(stored, source, target, pixel_filter, wrap, self.sampler)
        ingredients = [*closed_forms(problem), *(self.networks(problem) if self.learned else ())]
        long_run = self._long_run if self.long else NOT_KEPT
        with self._checkpoint(problem, long_run) as checkpoint:
            work = Work(problem, ingredients, self._seed, clock, progress, self._judged_by, long_run, checkpoint)
            search, found = self._searched(work, progress)
        progress(1.0)
        taken = any(self._neural.name in sources for sources in search.blend.sources)
        info = self._neural.weights(target, pixel_filter, source) if taken else None
        sampler, aim = (self.sampler, self.aim) if self.aims else (None, None)
        return PrefilterResult(
            search.levels,
            info.name if info else None,
            info.sha256 if info else None,
            found,
            sampler,
            aim,
            search.stopped,
        )

    @one_blas_thread()
    def _searched(self, work: Work, progress: Progress) -> tuple[Search, Measured]:
        """All stages, and what was measured of the result."""
        done, search = 0.0, resumed(work, self._effort)
        for step in self.steps:
            search = step.stage(search, lambda share, done=done, step=step: progress(done + share * step.share))  # type: ignore[misc]
            done += step.share
        return search, measured(search)

    @contextmanager
    def _checkpoint(self, problem: Problem, long_run: LongRun) -> Iterator[Checkpoint | None]:
        """What the search is kept in, and resumed from; None for nothing."""
        if long_run.checkpoint is None:
            yield None
            return
        options = (
            *(self.name, problem.target, problem.pixel_filter, problem.sampler, self.aim, self._seed, self._device),
            *(self._effort, self._judged_by, [step.stage for step in self.steps if isinstance(step.stage, Descend)]),
        )
        of = {
            "source": _hash(problem.source, problem.wrap, problem.stored),
            "options": _hash(options),
            "weights": _hash(self._weights_hash(problem)),
        }
        made = Checkpoint(long_run.checkpoint, of, self.seconds is not None, long_run.note)
        try:
            yield made
        finally:
            made.close()

    def _weights_hash(self, problem: Problem) -> str:
        """The weights that may take part; "" for none."""
        try:
            return self._neural.weights(problem.target, problem.pixel_filter, problem.source).sha256
        except UsageError:
            return ""

    def networks(self, problem: Problem) -> list[Ingredient]:
        """The network, where there are weights for it."""
        try:
            self._neural.weights(problem.target, problem.pixel_filter, problem.source)
        except UsageError:
            if self._named:
                raise
            return []
        learned = ingredient(problem, self._neural, problem.pixel_filter)
        # The first call of all loads the weights, and makes a graphics card ready. That must not count where a part
        # says how long the whole takes.
        learned.part(problem.stored[:_FIRST, :_FIRST])
        return [learned]


def measured(search: Search) -> Measured:
    """What held-out renders say of every level, and halfway between levels."""
    start, sets = search.blend, list(PAIR_SETS)
    found = start.held_out.of_stack(search.levels)
    levels, between = [], []
    for lod, score, rivals in zip(start.held_out.lods, found, start.rivals, strict=True):
        rows, others = score.log_errors, rivals.log_errors

        def by_set(values: Array) -> dict[str, float]:
            return {name: round(float(value), 4) for name, value in zip(sets, values, strict=True)}

        figures = {
            "snr": by_set(-DECIBEL * rows.mean(1)),
            "standard_error": by_set(DECIBEL * standard_error(rows)),
            "best_closed_form_snr": by_set(-DECIBEL * others.mean(1)),
            "gain_error": by_set(DECIBEL * standard_error(rows - others)),
        }
        best = dict(zip(sets, rivals.names, strict=True))
        if lod == int(lod):
            level = int(lod)
            sources, kept = start.sources[level], search.kept[level]
            levels.append(MeasuredLevel(best_closed_form=best, level=level, sources=sources, refined=kept, **figures))
        else:
            between.append(MeasuredBetween(best_closed_form=best, lod=lod, **figures))
    effort = start.held_out.effort
    pairs, points = effort.groups * SET_SIZE, effort.groups * effort.points
    visible = np.exp(np.mean([score.visible.mean(-1) for score in found] - start.plain))
    return Measured(tuple(levels), pairs, points, start.left_out, tuple(between), round(float(visible), 4))


def _hash(*content: object) -> str:
    """Of arrays by their values, of anything else by what Python says of it."""
    made = hashlib.sha256()
    for each in content:
        if isinstance(each, np.ndarray):
            for rows in memory.some_rows(each):
                made.update(each[rows].tobytes())
        else:
            made.update(repr(each).encode())
    return made.hexdigest()


def _refining(effort: ProbeEffort, descent: DescentEffort | None) -> Sequence[Step]:
    """The stages where all levels are refined; `descent` as a method was given it."""
    return (
        Step(Gather(effort), 0.1),
        Step(Make(blend), 0.0),
        Step(Descend(descent or REFINING, True, _TRUST), 0.9),
        Step(Keep(), 0.0),
    )


class Refine(Searching):
    """Every texel optimised, from the best blend that `auto` finds."""

    name = "refine"
    summary = f"auto, then every texel optimised within --budget ({REFINE_SECONDS / 60:g}m)"
    usual_seconds = REFINE_SECONDS

    @property
    def steps(self) -> Sequence[Step]:
        """The stages."""
        return _refining(self._effort, self._descent)


class Auto(Searching):
    """The best blend of a network and closed forms, with coarse levels optimised; with a budget, as `refine`."""

    name = "auto"
    summary = (
        "the best blend of neural and four closed forms, held by measurement against all that look fine, coarse levels "
        "optimised (several times as long as neural)"
    )

    @property
    def long(self) -> bool:
        """Whether it refines."""
        return self.budgeted

    @property
    def steps(self) -> Sequence[Step]:
        """The stages."""
        if self.long:
            return _refining(self._effort, self._descent)
        return (
            Step(Gather(self._effort), 0.5),
            Step(Make(blend), 0.0),
            Step(Descend(self._descent or COARSE, False, _TRUST), 0.5),
            Step(Keep(), 0.0),
        )


class Optimum(Searching):
    """The per-material optimum of a single-lobe stack, from the best closed form of each level."""

    name = "optimum"
    summary = "every texel optimised against the reference (slow; the limit of one lobe a texel)"
    learned = False
    aims = False

    def __init__(
        self,
        budget: str | None = None,
        seed: int = 0,
        effort: ProbeEffort = EFFORT,
        descent: DescentEffort | None = None,
        judged_by: Weights | None = None,
        long_run: LongRun = NOT_KEPT,
    ) -> None:
        judged_by = judged_by or SINGLE_LIGHTS
        super().__init__(None, budget, seed, effort, descent, judged_by, long_run=long_run)

    @property
    def steps(self) -> Sequence[Step]:
        """The stages."""
        return (
            Step(Gather(self._effort), 0.1),
            Step(Make(best), 0.0),
            Step(Descend(self._descent or OPTIMISING, True, 0.0), 0.9),
            Step(Keep(), 0.0),
        )
