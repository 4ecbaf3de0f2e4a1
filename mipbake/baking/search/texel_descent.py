"""Descent on the texels of a stack (methods.py says what for).

A round draws pixels, pairs and estimates of the reference anew (pixel_samples.py) and takes a few steps on them. Each
texel is divided by a curvature matrix of its own: the Gauss-Newton matrices of all pixels that look it up, each
weighted by the texel's share in the lookup. Shares sum to 1, so by Jensen's inequality these blocks bound the coupled
matrix from above: all texels step at once without overshooting.

The noise of a round is averaged in two ways. Curvature of past rounds holds texels where they are, as in recursive
least squares, so steps shrink like 1 / rounds; and what is kept is an average over rounds, later ones counting more.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.search import rounds
from mipbake.baking.search.long_run import Stop, never
from mipbake.baking.search.pair_weights import PairWeights
from mipbake.baking.search.picture_samples import PictureChunk, picture_chunks, texels_around
from mipbake.baking.search.pixel_samples import Chunk, Lobes, common_pairs, estimates, own_pairs
from mipbake.baking.search.regions import Crop
from mipbake.base.errors import UsageError
from mipbake.base.timings import Progress
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Errors, Scores, snr_text
from mipbake.quality.judging.terms import SINGLE_LIGHTS, Weights
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Image, Problem, Region

CHECK = 5
"""Rounds between two looks at what the stack is worth."""

_PICTURES = 16  # of a level and round
_STILL = 2  # looks in a row at which nothing moved, after which a region is done
_CONVERGED = 0.01  # nepers gained between two looks from which a level counts as moving
_OWN_PAIRS = 3  # levels whose pixels have pairs of their own
# Times as many common pairs, at most; where pixels are more than this, fewer.
_COMMON, _COMMON_PIXELS = 4, 2048
_LEAST_PIXELS = 128  # pixels of a level and round: the coarsest levels have a texel or two
LOBES = 2
"""Lobes that half vectors of pixels are drawn from (pixel_samples.py). Not tuned: what is drawn from has so many."""

LOOKS = ProbeEffort(groups=16)  # groups of the renders that say whether rounds still help


@dataclass(frozen=True)
class DescentEffort:
    """How much effort a descent makes.

    Args:
        rounds: most rounds of a region. A round draws pixels, pairs and estimates of the reference anew.
        steps: Gauss-Newton steps of a round.
        pairs: light-view pairs of each pixel in a round, a multiple of 2 + LOBES: each has its own.
        samples: reference samples of a pixel of level 0; they double with every second level.
        looks: effort of the renders that say, after every few rounds, whether that still helps.
        window: regions of large sets are at most so many texels a side.
        coarse: levels of at most so many texels a side are optimised together.
    """

    rounds: int = 40
    steps: int = 2
    pairs: int = 32
    samples: int = 8
    window: int = 512
    coarse: int = 128
    looks: ProbeEffort = LOOKS

    def __post_init__(self) -> None:
        least = {"rounds": 0, "steps": 1, "pairs": 4, "samples": 2, "window": 8, "coarse": 1}
        for name, low in least.items():
            value = getattr(self, name)
            if not isinstance(value, int) or value < low:
                raise UsageError(f"DescentEffort was given {name}={value!r}: expected a whole number from {low} up")
        if self.pairs % (len(PAIR_SETS) + LOBES):
            raise UsageError(
                f"DescentEffort was given pairs={self.pairs}: expected a multiple of {len(PAIR_SETS) + LOBES}"
            )


class Stopped(Exception):  # noqa: N818  it is no error
    """A region was left before it was done."""


@dataclass(eq=False)
class Descent:
    """What regions are optimised for, and how.

    Args:
        moving: whether the texels of each level may move.
        effort: effort on a region.
        trust: how many rounds of evidence the start is worth: it holds texels as so many past rounds would.
        judged_by: what errors count.
        typical: (C,) stored channels of the model PLAIN that shade about as bright as the whole set; None for the mean
            of the wide lobes.
    """

    problem: Problem
    moving: Sequence[bool]
    effort: DescentEffort
    trust: float = 0.0
    judged_by: Weights = SINGLE_LIGHTS
    typical: Image | None = None

    @cached_property
    def lobes(self) -> list[Lobes]:
        """What half vectors of fine levels are drawn from: stacks, which coarse levels do without."""
        return Lobes.under(self.problem)

    @property
    def bright_as(self) -> Image:
        """`typical`, where it is None the mean of the wide lobes."""
        return self.lobes[-1].levels[-1][0, 0] if self.typical is None else self.typical


def descend(
    descent: Descent,
    levels: list[Image],
    region: Region,
    rng: np.random.Generator,
    deadline: float = math.inf,
    progress: Progress = lambda _: None,
    note: Callable[[str], None] = lambda _: None,
    stop: Stop = never,
    worked: Callable[[int], None] = lambda _: None,
) -> tuple[int, bool]:
    """Optimises the texels of a region, until looks at other renders of it see no gain.

    Args:
        levels: (H_L, W_L, C) the stack, changed in place inside the region.
        deadline: time.monotonic() after which no round begins.
        note: takes the SNR at each look.
        stop: is called many times in a round; where it says True, the best look ends the work.
        worked: takes, after each round, how many there were.

    Returns:
        The rounds that were worked, and whether it was stopped before it was done.
    """
    work = _Working(descent, levels, region, rng, note, stop)
    began, most = time.monotonic(), descent.effort.rounds
    looked, stopped = True, False
    # What a round is fitted to does not hang on where the texels are: it is drawn while the last one is worked on.
    with ThreadPoolExecutor(1) as ahead_of_time:
        drawn = ahead_of_time.submit(work.draw, 0) if work.free and most else None
        try:
            while drawn is not None:
                started = time.monotonic()
                renders, pictures = drawn.result()
                more = work.done + 1 < most and started < deadline
                drawn = ahead_of_time.submit(work.draw, work.done + 1) if more else None
                work.round(renders, pictures)
                del renders, pictures
                finished = time.monotonic()
                # Half a round late is no later on average than half a round early.
                late = finished + (finished - started) / 2 > deadline
                share = (finished - began) / max(1e-9, deadline - began)
                progress(min(1.0, max(work.done / most, share)))
                looked = not (work.done % CHECK and drawn is not None and not late)
                if looked:
                    work.look()
                if looked and (work.still == _STILL or late):
                    if drawn is not None:
                        drawn.cancel()
                    break
                worked(work.done)
        except Stopped:
            stopped = True
    if not looked:  # rounds that nobody has looked at yet may be the best
        work.look()
    # Where the last rounds lost more than they gained, the texels are as the best look found them.
    for i, texels in work.best.items():
        levels[i][work.free[i].window] = texels
    return work.done, stopped


class _Working:
    """A descent at work in a region: what `descend` has of its texels, from round to round."""

    def __init__(
        self,
        descent: Descent,
        levels: list[Image],
        region: Region,
        rng: np.random.Generator,
        note: Callable[[str], None],
        stop: Stop,
    ) -> None:
        self._descent, self._levels, self._region, self._rng = descent, levels, region, rng
        self._note, self._stop = note, stop
        problem = descent.problem
        near = range(max(0, region.levels.start - 1), min(len(levels), region.levels.stop + 1))
        self._crops = {
            i: Crop(
                *(levels[i], region, problem),
                i in region.levels and descent.moving[i],
                texels_around(problem, region, i),
            )
            for i in near
        }
        self.free = {i: crop for i, crop in self._crops.items() if crop.free}
        for crop in self.free.values():
            crop.move(crop.coordinates)
        # At the levels of detail of the levels and half a level further.
        lods = [level + half for level in region.levels for half in (0.0, 0.5) if level + half <= problem.last]
        self._scores = Scores(problem, descent.effort.looks, [int(rng.integers(1 << 31))], lods, region)
        errors = self._scores.stack_errors(levels)
        self._judge = Judge([Baseline.of(each.score) for each in errors], descent.judged_by)
        self._weights = PairWeights(self._scores, self._judge, descent.bright_as)
        self._weights.update(errors)
        self._last = self._values(errors)
        self._least, self.best = self._last.sum(), self._within()
        self.done, self.still, self._seed = 0, 0, int(rng.integers(1 << 31))

    def _pause(self) -> None:
        if self._stop():
            raise Stopped

    def draw(self, turn: int) -> tuple[list[tuple[Chunk, Image]], list[PictureChunk]]:
        """The chunks of a round, with (K, P, 3) estimates of the reference."""
        problem, effort, rng = self._descent.problem, self._descent.effort, np.random.default_rng([self._seed, turn])
        out, pictures = list[tuple[Chunk, Image]](), list[PictureChunk]()
        for level in self._region.levels:
            uv = _some(self._crops[level].pixels(_LEAST_PIXELS, rng), problem.thinned, rng)
            if level < _OWN_PAIRS:
                chunks = own_pairs(problem, self._descent.lobes, level, uv, effort.pairs, turn, rng)
            else:
                many = renders_of_pixel(level, len(uv), effort.pairs)
                chunks = common_pairs(problem, self._weights.pairs(level), level, uv, many, rng)
            for chunk in chunks:
                self._pause()
                if any(index in self.free for index, _ in chunk.seen):
                    out.append((replace(chunk, pixels=len(uv)), estimates(problem, chunk, effort.samples, rng)))
            pictures += picture_chunks(problem, self._region, level, _PICTURES, effort.samples, rng)
        return out, [chunk for chunk in pictures if any(index in self.free for index, _ in chunk.seen)]

    def round(self, renders: Sequence[tuple[Chunk, Image]], pictures: list[PictureChunk]) -> None:
        """One round; where it is abandoned, `look` does not see what it did."""
        drawn, descent = rounds.Drawn.of(self._crops, renders, self._weights, pictures), self._descent
        rounds.work(self.free, drawn, descent.effort.steps, descent.trust, self.done, self._rng, self._pause)
        self.done += 1

    def look(self) -> None:
        """What the stack is worth now, in renders that no round is fitted to."""
        levels, scores = self._levels, self._scores
        for i, crop in self.free.items():
            assert crop.mean is not None
            levels[i][crop.window] = crop.values(crop.mean)
        errors = scores.stack_errors(levels)
        self._weights.update(errors)
        now = self._values(errors)
        self._note(snr_text(np.mean([each.score.decibels for each in errors], 0)))
        gains, self._last = self._last - now, now
        if now.sum() < self._least:
            self._least, self.best = now.sum(), self._within()
        # Of a level in the mean over the levels of detail within 1/2 of it.
        near = [np.abs(np.array(scores.lods) - level) <= 0.5 for level in self._region.levels]
        self.still = self.still + 1 if all(gains[each].mean() < _CONVERGED for each in near) else 0

    def _values(self, errors: Sequence[Errors]) -> NDArray[np.float64]:
        """(M,) what a stack is worth at each level of detail."""
        return np.array([self._judge.value(each.score, index) for index, each in enumerate(errors)])

    def _within(self) -> dict[int, Image]:
        """Copies of what the stack has in the region."""
        return {i: self._levels[i][crop.window].copy() for i, crop in self.free.items()}


def pixels_of_round(problem: Problem, region: Region, level: int) -> int:
    """About how many pixels of a level a round in a region draws."""
    height, width = problem.sizes[level]
    return max(_LEAST_PIXELS, math.ceil(float(height * width * region.extent.prod())))


def renders_of_pixel(level: int, pixels: int, pairs: int) -> int:
    """How many renders each of so many pixels of a level has in a round: a pair each; the effort says `pairs`."""
    return pairs if level < _OWN_PAIRS else pairs * max(1, min(_COMMON, _COMMON_PIXELS // pixels))


def _some(uv: NDArray[np.float64], thinned: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """One in so many of (P, 2) pixels, at random, in their order; no fewer than a round has at least."""
    if thinned == 1:
        return uv
    count = max(min(len(uv), _LEAST_PIXELS), len(uv) // thinned)
    return np.asarray(uv[np.sort(rng.permutation(len(uv))[:count])])
