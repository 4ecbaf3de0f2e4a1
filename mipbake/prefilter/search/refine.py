"""`refine` and `auto`: the best blend of all methods at every level, then texels optimised where time is best spent.

Both start from the blend (blending.py), which costs seconds and is better than any of its ingredients. From there
texels are optimised one by one (texel_descent.py), held by what the blend knows: so nothing is lost to noise in the
first rounds, and a few rounds already gain. Coarse levels have few texels and are seen from afar: they come first and
cost next to nothing. `auto` stops there; `refine`, or `auto` with a budget, goes on to the fine levels.

Each level has a share of the time that grows with the root of its texels, since gains fall off with time spent. Where
a level would get so little that a round or two is all, its blend stays and the others have its time.

In the end each level keeps of its change what independent renders confirm, against the blend, which itself was held
against every closed form. What they measured is the promise that comes with the stack.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mipbake import directions, material
from mipbake.errors import UsageError
from mipbake.judging.held_out import SET_SIZE
from mipbake.judging.scores import DECIBEL, Array, Effort, Score, Scores
from mipbake.metrics.pairs import PAIR_SETS
from mipbake.pixel_filter import Wrap, filter_named
from mipbake.prefilter.base import PrefilterResult, Progress, say
from mipbake.prefilter.neural import Neural
from mipbake.prefilter.promise import BetweenPromise, LevelPromise, Promise
from mipbake.prefilter.search.blending import Blend, blend, settle
from mipbake.prefilter.search.blending import standard_error as error_of_mean
from mipbake.prefilter.search.budget import Budget
from mipbake.prefilter.search.ingredients import Candidate, Rival, candidate, closed_forms, mean
from mipbake.prefilter.search.time_budget import seconds_of
from mipbake.reference.problem import Image, Problem, Region

DEFAULT_EFFORT = Effort()
DEFAULT_BUDGET = Budget(rounds=60, points=96, held_out_pairs=512, lit=True)
AUTO_BUDGET = Budget(rounds=6, pairs=16, samples=4, points=48, held_out_pairs=256, lit=True)
"""Effort on coarse levels, where not all are refined: few rounds, held by the blend, which need no more."""

REFINE_SECONDS = 120.0
"""Budget of `refine` where none is given."""

_COARSE = 128  # texels a side up to which levels are refined together, and without being asked
_TRUST = 12.0  # rounds that a blend is worth: measured against 4 and 50, after 6 rounds and after 24
_LIT_SLACK = 0.1  # how much the logarithm of the error under the studio's lights may grow
_FEWEST = 3  # rounds that are worth beginning with a level
_SOLVED_DB = 60.0  # SNR from which a level is left alone
_BAKING = 0.75  # most of the time that ingredients take; in a large set, an ingredient that takes longer is left out
_SETTLING = 0.04  # share of the time left after the blend, for judging what was gained


@dataclass(frozen=True)
class _Step:
    """Part of the work.

    Args:
        region: the texels and levels that are optimised, all else held.
        share: of the time, in proportion to the other steps.
    """

    region: Region
    share: float


class Refine:
    """Every texel optimised, from the best blend of all methods.

    Args:
        weights: trained weights by name; None for the default ones, and without a network where there are none.
        budget: time as users write it (time_budget.py); None for REFINE_SECONDS.
        seed: seed of all that is drawn.
    """

    name = "refine"
    summary = f"auto, then every texel optimised within --budget ({REFINE_SECONDS / 60:g}m)"
    averages = False

    def __init__(self, weights: str | None = None, budget: str | None = None, seed: int = 0) -> None:
        self._neural, self._seed = Neural(weights), seed
        self._named = weights is not None
        self.seconds = REFINE_SECONDS if budget is None else seconds_of(budget)
        self.everything = True

    def __call__(
        self, stored: Image, source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter. UsageError where named weights do not fit the target or the pixel filter."""
        began = time.monotonic()
        from mipbake.models.workers import one_torch_thread

        filter_named(pixel_filter)
        problem = Problem(stored, source, target, pixel_filter, wrap)
        learned = self._learned(problem)
        candidates = [*closed_forms(problem), *learned]
        first = 0.5 if not self.everything else 0.1  # share of the progress
        timed = self.everything and self.seconds is not None
        seconds = self.seconds if timed and self.seconds is not None else math.inf
        # Tensors here are small and many, and two Python threads work on them.
        with one_torch_thread():
            start = blend(
                problem,
                candidates,
                DEFAULT_EFFORT,
                self._seed,
                lambda share: progress(first * share),
                began + _BAKING * seconds,
            )
            refined = _refined(problem, start, began + seconds, self.everything, self._seed, _Part(progress, first))
        progress(1.0)
        taken = any(self._neural.name in sources for sources in start.sources)
        info = self._neural.weights(target, pixel_filter, source) if taken else None
        return PrefilterResult(
            refined.levels, info.name if info else None, info.sha256 if info else None, promised(start, refined)
        )

    def _learned(self, problem: Problem) -> list[Candidate]:
        """The network, where there are weights for it."""
        try:
            self._neural.weights(problem.target, problem.pixel_filter, problem.source)
        except UsageError:
            if self._named:
                raise
            return []
        return [candidate(problem, self._neural, problem.pixel_filter)]


class Auto(Refine):
    """The best blend of all methods, with coarse levels optimised; with a budget, all levels."""

    name = "auto"
    summary = (
        "the best blend of neural and all closed forms, by measurement, coarse levels optimised (several times as long "
        "as neural)"
    )

    def __init__(self, weights: str | None = None, budget: str | None = None, seed: int = 0) -> None:
        super().__init__(weights, budget, seed)
        self.everything = budget is not None


@dataclass(frozen=True)
class _Part:
    """Progress of what comes after the first share of the work."""

    progress: Progress
    first: float

    def __call__(self, share: float) -> None:
        self.progress(self.first + (1 - self.first) * share)

    def note(self, text: str) -> None:
        say(self.progress, text)


@dataclass(frozen=True, eq=False)
class _Refined:
    """What became of a blend: levels, how much of their changes was kept, and the scores that the witness gives."""

    levels: list[Image]
    shares: list[float]
    witnessed: list[Score]


def _refined(problem: Problem, start: Blend, deadline: float, everything: bool, seed: int, progress: _Part) -> _Refined:
    """Optimises texels from the coarsest levels on until the deadline, and keeps what the judge confirms."""
    from mipbake.prefilter.search.optimum import lobes_under
    from mipbake.prefilter.search.pixel_samples import Lobes
    from mipbake.prefilter.search.texel_descent import descend

    judge, last = start.judge, problem.last
    before = scored(judge, start.levels)
    worst = np.array([score.decibels.min() for score in before])
    moving = [bool((worst[max(0, 2 * i - 1) : 2 * i + 2] < _SOLVED_DB).any()) for i in range(last + 1)]
    levels = [level.copy() for level in start.levels]
    steps = [step for step in _steps(problem, everything) if any(moving[i] for i in step.region.levels)]
    if not steps:
        return _Refined(start.levels, [0.0] * (last + 1), scored(start.witness, start.levels))
    lobes = [Lobes(each) for each in lobes_under(problem)]
    ahead = np.zeros((len(PAIR_SETS), len(judge.lods)))
    timed = not math.isinf(deadline)
    if timed:
        deadline -= _SETTLING * max(0.0, deadline - time.monotonic())
    total, done = sum(step.share for step in steps), 0.0
    pace = 0.0  # seconds that a round takes for a texel
    for index, step in enumerate(steps):
        rest = sum(each.share for each in steps[index:])
        now = time.monotonic()
        until = now + max(0.0, deadline - now) * step.share / rest if timed else math.inf
        texels = _texels(problem, step.region)
        if timed and until - now <= _FEWEST * pace * texels:
            done += step.share
            continue
        spoken = f"level {step.region.levels.start}" + (f" to {last}" if step.region.levels.stop > last else "")
        rounds = descend(
            problem,
            levels,
            step.region,
            moving,
            lobes,
            ahead,
            DEFAULT_BUDGET if everything else AUTO_BUDGET,
            np.random.default_rng([seed, 3, index]),
            until,
            lambda share, done=done, step=step: progress(min(0.99, (done + share * step.share) / total)),  # type: ignore[misc]
            _TRUST,
            lambda snr, spoken=spoken: progress.note(f"{spoken}: {spoken_snr(snr.mean(1))}"),  # type: ignore[misc]
        ).rounds
        pace = (time.monotonic() - now) / max(1, rounds) / texels
        done += step.share
    shares = _kept(problem, start, levels, before)
    kept = [_between(*each, problem.target) for each in zip(start.levels, levels, shares, strict=True)]
    kept = directions.aligned(kept, problem.target, problem.wrap)
    return _Refined(kept, shares, scored(start.witness, kept))


def _steps(problem: Problem, everything: bool) -> Iterator[_Step]:
    """Coarse levels together, then finer ones one by one, in windows where they are large."""
    sizes = problem.sizes
    fine = sum(max(size) > _COARSE for size in sizes)
    yield _Step(Region(0, 1, 0, 1, range(fine, len(sizes))), math.sqrt(_COARSE * _COARSE))
    if not everything:
        return
    for level in range(fine - 1, -1, -1):
        height, width = sizes[level]
        window = DEFAULT_BUDGET.window
        rows, columns = -(-height // window), -(-width // window)
        top, left = np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1)
        for i in range(rows):
            for j in range(columns):
                region = Region(
                    float(top[i]), float(top[i + 1]), float(left[j]), float(left[j + 1]), range(level, level + 1)
                )
                yield _Step(region, math.sqrt(height * width) / (rows * columns))


def _texels(problem: Problem, region: Region) -> float:
    """How many texels a round works on, and a thousand more for what does not depend on that number."""
    each = [height * width for height, width in (problem.sizes[level] for level in region.levels)]
    return sum(each) * float(region.extent.prod()) + 1000.0 * len(region.levels)


def _between(first: Image, second: Image, share: float, model: str) -> Image:
    """first + share (second - first); exact at both ends."""
    if share in (0.0, 1.0):
        return second if share else first
    return material.regularise(first + np.float32(share) * (second - first), model)


def scored(scores: Scores, levels: Sequence[Image]) -> list[Score]:
    """Scores of a stack at all levels of detail of the probes of a judge or a witness."""
    return [
        scores.of(mean([scores.looked_up(levels[level], index) for level in probe.levels]), index)
        for index, probe in enumerate(scores.probes)
    ]


def _kept(problem: Problem, start: Blend, levels: Sequence[Image], before: Sequence[Score]) -> list[float]:
    """The share of each level's change that the judge confirms against the start; 0 where it confirms none."""
    judge, cache = start.judge, dict[tuple[int, int], tuple[Image, Image]]()

    def texels(index: int, level: int, share: float) -> Image:
        if (index, level) not in cache:
            cache[index, level] = (
                judge.looked_up(start.levels[level], index),
                judge.looked_up(levels[level], index),
            )
        return _between(*cache[index, level], share, problem.target)

    rivals = [[Rival("start", row) for row in score.rows] for score in before]
    lit = [max(asked, score.lit_log) for asked, score in zip(start.lit, before, strict=True)]
    shares = settle(judge, texels, len(levels), rivals, lit, start.plain, _LIT_SLACK)
    changed = [not np.array_equal(*each) for each in zip(start.levels, levels, strict=True)]
    return [share if moved else 0.0 for share, moved in zip(shares, changed, strict=True)]


def promised(start: Blend, refined: _Refined) -> Promise:
    """What the witness found of every level, and halfway between levels."""
    sets = list(PAIR_SETS)
    levels, between = [], []
    for lod, score, rivals in zip(start.witness.lods, refined.witnessed, start.witnessed, strict=True):
        rows, others = score.log_errors, np.stack([rival.log_errors for rival in rivals])

        def by_set(values: Array) -> dict[str, float]:
            return {name: round(float(value), 4) for name, value in zip(sets, values, strict=True)}

        found = {
            "snr": by_set(-DECIBEL * rows.mean(1)),
            "standard_error": by_set(DECIBEL * error_of_mean(rows)),
            "best_closed_form_snr": by_set(-DECIBEL * others.mean(1)),
            "gain_error": by_set(DECIBEL * error_of_mean(rows - others)),
        }
        best = {name: rival.name for name, rival in zip(sets, rivals, strict=True)}
        if lod == int(lod):
            level = int(lod)
            share = refined.shares[level]
            levels.append(
                LevelPromise(best_closed_form=best, level=level, sources=start.sources[level], refined=share, **found)
            )
        else:
            between.append(BetweenPromise(best_closed_form=best, lod=lod, **found))
    effort = start.witness.effort
    pairs, points = effort.groups * SET_SIZE, effort.groups * effort.points
    return Promise(tuple(levels), pairs, points, start.left_out, tuple(between))


def spoken_snr(snr: Array) -> str:
    """`near-mirror 21.3 dB, hemisphere 24.1 dB`."""
    return ", ".join(f"{name} {value:.1f} dB" for name, value in zip(PAIR_SETS, snr, strict=True))
