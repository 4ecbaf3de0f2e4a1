"""`auto`, `refine` and `optimum`: three plans of one search.

All gather ingredients and make levels of them. `auto` is the best blend, which costs about as much again as the network
in it. `refine`, and `auto` with a budget, measure the blend with more effort, and optimise its texels one by one
(texel_descent.py), held by what the blend knows: so nothing is lost to noise in the first rounds, and a few rounds
already gain. Coarse levels have few texels and are seen from afar: they come first. `optimum` starts from the best
closed form of each level, is held by nothing, and shows the limit of a stack with a single lobe a texel.

In the end each level keeps of its change what independent renders confirm, against the start, which itself was held
against every closed form that looks fine. Held-out renders measure the result.
"""

from __future__ import annotations

import hashlib
import math
import time
from contextlib import closing, nullcontext

import numpy as np

from mipbake.baking.neural import Neural
from mipbake.baking.prefilter import PrefilterResult
from mipbake.baking.search.blending import best, blend
from mipbake.baking.search.checkpoint import Checkpoint
from mipbake.baking.search.ingredients import Ingredient, closed_forms, ingredient
from mipbake.baking.search.long_run import NOT_KEPT, LongRun, seconds_of
from mipbake.baking.search.stages import Plan, Search
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.base import memory
from mipbake.base.device import PROCESSOR
from mipbake.base.errors import UsageError
from mipbake.base.threads import one_blas_thread
from mipbake.base.timings import Progress
from mipbake.material.aim import DEFAULT_AIM, DEFAULT_SAMPLER, Sampler, checked_aim
from mipbake.material.pixel_filter import Wrap, filter_named
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.terms import SINGLE_LIGHTS, Weights, weights_for
from mipbake.quality.reference.problem import Image, Problem

REFINE_SECONDS = 120.0
"""Budget of `refine` where none is given."""

EFFORT = ProbeEffort()
"""Of the renders that judge where texels are optimised, which takes far longer."""

REFINING = DescentEffort(rounds=60, looks=ProbeEffort(groups=8, points=96, pictures=16))
"""Its numbers are guesses."""

OPTIMISING = DescentEffort()

# Rounds that a blend is worth: measured against 4 and 50, after 6 rounds and after 24; no record holds the figures.
_TRUST = 12.0
# Of a blend alone: groups and pictures at the least side, the power of the side that they grow with, and the sides that
# they grow between. Guesses: a part of what the network of a set costs.
_GROUPS, _PICTURES, _POWER, _SIDES = 8, 28, 0.65, (256, 1024)


class Searching:
    """A method that searches.

    Args:
        weights: trained weights by name; None for the default ones, and without a network where there are none.
        budget: time as users write it (long_run.py); None for what is usual. Only without a limit of time are
            results reproducible.
        seed: seed of all that is drawn.
        effort: of the renders that judge. descent: effort on the levels. None for what is usual.
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
    """The pictures and pixels that it measures with, and what ingredients show there; measured while it refined."""
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
        effort: ProbeEffort | None = None,
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
    def plan(self) -> Plan:
        """What it does."""
        raise NotImplementedError

    def effort(self, problem: Problem) -> ProbeEffort:
        """Of the renders that judge."""
        return self._effort or (EFFORT if self.plan.effort else blending_effort(*problem.sizes[0]))

    @property
    def long(self) -> bool:
        """Whether it may take long enough to be stopped, kept and resumed."""
        return True

    def __call__(
        self, stored: Image, source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter. UsageError where named weights do not fit the target or the pixel filter."""
        began = time.monotonic()
        filter_named(pixel_filter)
        problem = Problem(stored, source, target, pixel_filter, wrap, self.sampler)
        ingredients = [*closed_forms(problem), *(self._networks(problem) if self.learned else ())]
        long_run = self._long_run if self.long else NOT_KEPT
        checkpoint = self._checkpoint(problem, long_run)
        seconds = math.inf if self.seconds is None else self.seconds
        effort = self.effort(problem)
        search = Search(problem, effort, self._judged_by, self._seed, progress, long_run, checkpoint, seconds, began)
        with one_blas_thread(), nullcontext() if checkpoint is None else closing(checkpoint):
            search.begin(ingredients, self.plan)
            search.descend(self.plan)
            search.keep()
            measured = search.measured()
        progress(1.0)
        taken = any(self._neural.name in sources for sources in search.start.sources)
        info = self._neural.weights(target, pixel_filter, source) if taken else None
        sampler, aim = (self.sampler, self.aim) if self.aims else (None, None)
        name, sha256 = (info.name, info.sha256) if info else (None, None)
        return PrefilterResult(search.levels, name, sha256, measured, sampler, aim, search.stopped)

    def _checkpoint(self, problem: Problem, long_run: LongRun) -> Checkpoint | None:
        """What the search is kept in, and resumed from; None for nothing."""
        if long_run.checkpoint is None:
            return None
        try:
            weights = self._neural.weights(problem.target, problem.pixel_filter, problem.source).sha256
        except UsageError:  # a search without a network
            weights = ""
        options = (
            *(self.name, problem.target, problem.pixel_filter, problem.sampler, self.aim, self._seed, self._device),
            *(self.effort(problem), self._judged_by, self.plan.effort, self.plan.trust),
        )
        of = {
            "source": _hash(problem.source, problem.wrap, problem.stored),
            "options": _hash(options),
            "weights": _hash(weights),
        }
        return Checkpoint(long_run.checkpoint, of, self.seconds is not None, long_run.note)

    def _networks(self, problem: Problem) -> list[Ingredient]:
        """The network, where there are weights for it."""
        try:
            self._neural.weights(problem.target, problem.pixel_filter, problem.source)
        except UsageError:
            if self._named:
                raise
            return []
        return [ingredient(problem, self._neural, problem.pixel_filter)]


def blending_effort(height: int, width: int) -> ProbeEffort:
    """Effort for a blend alone: small sets, whose networks take no time, have fewer renders."""
    low, high = _SIDES
    growth = (min(max(math.sqrt(height * width), low), high) / low) ** _POWER
    groups, pictures = (round(each * growth) for each in (_GROUPS, _PICTURES))
    return ProbeEffort(groups, points=16, pictures=pictures, picture_samples=2, doublings=1)


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


class Refine(Searching):
    """Every texel optimised, from the best blend that `auto` finds."""

    name = "refine"
    summary = f"auto, then every texel optimised within --budget ({REFINE_SECONDS / 60:g}m)"
    usual_seconds: float | None = REFINE_SECONDS

    @property
    def plan(self) -> Plan:
        """See Searching."""
        return Plan(blend, self._descent or REFINING, trust=_TRUST)


class Auto(Refine):
    """The best blend of a network and closed forms; with a budget, as `refine`."""

    name = "auto"
    summary = (
        "the best blend of neural and four closed forms, held by measurement against all of these that look fine "
        "(twice as long as neural)"
    )
    usual_seconds = None
    own_memory = 1 << 28
    """Measured without a budget."""

    @property
    def long(self) -> bool:
        """Whether it refines."""
        return self.budgeted

    @property
    def plan(self) -> Plan:
        """See Searching."""
        return super().plan if self.long else Plan(blend, None)


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
        effort: ProbeEffort | None = None,
        descent: DescentEffort | None = None,
        judged_by: Weights = SINGLE_LIGHTS,
        long_run: LongRun = NOT_KEPT,
    ) -> None:
        super().__init__(None, budget, seed, effort, descent, judged_by, long_run=long_run)

    @property
    def plan(self) -> Plan:
        """See Searching."""
        return Plan(best, self._descent or OPTIMISING)
