"""`optimum`: every texel of every level optimised against the reference, the limit of a single-lobe stack.

Closed forms and networks guess texels; this method descends on them. Pixels at random offsets and levels of detail look
the stack up trilinearly, are shaded once under random light-view pairs, and are compared with the pixel-filtered render
of level 0 (equation 3 of Kemppinen et al. 2023): levels are coupled as they are in an engine. It starts from the best
closed form of each level and keeps what held-out pairs confirm.

Plain descent is not safe: a few very bright pairs drive single texels to mirrors, and the noise of few pairs makes a
random walk of fine levels. So:

- pixels have pairs of their own, drawn where their lobes are (pixel_samples.py);
- renders weigh so that decibels of sets of pairs are gained, and where the fit is behind the best closed form, of
  whatever level of detail and pair set, it gains weight (pair_weights.py);
- each texel has a curvature matrix, which remembers: steps shrink as evidence grows (texel_descent.py);
- in the end each level takes the share of its change that held-out pairs like best, and none where they are worse off.

It ends when held-out pairs stop improving, and says what the last rounds gained. Large sets are worked on in blocks:
the coarse levels as a whole, then the fine ones window by window, with everything else held at its latest values.
Pixels up to a texel beyond a window take part in it, so the texels on both sides of a border are fitted to the same
renders, and the shares of the end hold for whole levels: there is no seam to see.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mipbake import directions, material
from mipbake.errors import UsageError
from mipbake.judging.held_out import HeldOut
from mipbake.judging.weights import DESCENT
from mipbake.material import model_named
from mipbake.pixel_filter import Wrap, filter_named
from mipbake.prefilter.base import PrefilterResult, Progress
from mipbake.prefilter.search.budget import Budget
from mipbake.prefilter.search.time_budget import seconds_of
from mipbake.reference.problem import Image, Problem, Region, whole

_SOLVED_DB = 60.0  # SNR from which a level is left alone: its error is far below what 8 bits resolve
_SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)  # shares of a level's change that may be kept
_DECIBEL = 10 / math.log(10)

DEFAULT_BUDGET = Budget()


@dataclass(frozen=True)
class Refined:
    """An optimised stack and what held-out pairs say about it.

    Args:
        levels: (H_L, W_L, C) float32 valid stored channels.
        lods: (M,) measured levels of detail, from 0 to the last level in steps of 1/2.
        before, after: (S, M) SNR in dB of the start and of the result, the mean over held-out sets of 64 pairs, one row
            for each kind of set (mipbake.metrics.pairs.PAIR_SETS).
        shares: of each level's change, how much was kept, from 0 to 1.
        last_gain: (L,) dB that each level gained in the last rounds before the descent ended, on held-out pairs: how
            far it is from having converged. 0 for levels that were left alone.
        rounds: that were worked, in all blocks.
        seconds: that it took.
    """

    levels: list[Image]
    lods: NDArray[np.float64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    shares: tuple[float, ...]
    last_gain: NDArray[np.float64]
    rounds: int
    seconds: float = field(compare=False)


@dataclass(frozen=True)
class Start:
    """A stack to start from, and what else there is.

    Args:
        levels: (H_L, W_L, C) valid stored channels of the target, every level to 1 x 1.
        ahead: (S, M) logarithms of the error by which the best closed form is ahead of it, at levels of detail in steps
            of 1/2; 0 where none is.
    """

    levels: list[Image]
    ahead: NDArray[np.float64]


class Optimum:
    """The per-material optimum of a single-lobe stack, from the best closed form of each level."""

    name = "optimum"
    summary = "every texel optimised against the reference (slow; the limit of one lobe a texel)"
    averages = False

    def __init__(self, budget: Budget | None = None, seed: int = 0) -> None:
        self.budget, self.seed = budget, seed

    @classmethod
    def within(cls, budget: str) -> Optimum:
        """The method with a time budget as users write it (time_budget.py)."""
        return cls(Budget(seconds=seconds_of(budget)))

    def __call__(
        self, stored: NDArray[np.float32], source: str, target: str, pixel_filter: str, wrap: Wrap, progress: Progress
    ) -> PrefilterResult:
        """See Prefilter."""
        problem, budget = Problem(stored, source, target, pixel_filter, wrap), self.budget or DEFAULT_BUDGET
        start = best_closed_form(problem, budget, self.seed)
        return PrefilterResult(refine(problem, start, budget, self.seed, progress).levels)


def best_closed_form(problem: Problem, budget: Budget = DEFAULT_BUDGET, seed: int = 0) -> Start:
    """A stack that takes each level from the closed form that held-out pairs like best there.

    All closed forms take part, each with the pixel filter and with the box as its averaging kernel. The measure is the
    mean of the SNR on all pair sets.
    """
    from mipbake.prefilter import METHODS

    held_out = HeldOut(problem, whole(problem), budget.held_out.part(2), [seed, 1])
    best: list[Image] = []
    every: list[NDArray[np.float64]] = []
    scores = np.zeros(0)
    for kernel in dict.fromkeys((problem.pixel_filter, "box")):
        for method in METHODS.values():
            if not method.averages:
                continue
            levels = method(problem.stored, problem.source, problem.target, kernel, problem.wrap, lambda _: None).levels
            every.append(held_out.typical(levels))
            score = every[-1].mean(0)[::2]
            if not best:
                best, scores = levels, score
            for level in range(len(levels)):
                if score[level] < scores[level] - 1e-3:  # no mixture of methods that measure the same
                    best[level], scores[level] = levels[level], score[level]
    best = directions.aligned(best, problem.target, problem.wrap)
    return Start(best, np.maximum(held_out.typical(best) - np.min(every, 0), 0))


def refine(
    problem: Problem,
    start: Start | Sequence[Image],
    budget: Budget = DEFAULT_BUDGET,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Refined:
    """Optimises all texels of all levels, and keeps of it what held-out pairs confirm.

    Args:
        problem: the source and what the stack is for.
        start: (H_L, W_L, C) valid stored channels of model `problem.target`, every level to 1 x 1. Not changed.
        budget: how long.
        seed: seed of all that is drawn. The result is the same for a seed, unless the budget ends by time.
        progress: told the finished share.

    Raises:
        UsageError: a start that is not a complete stack of the target model, or an unknown pixel filter.
    """
    from mipbake.prefilter.search.pixel_samples import Lobes
    from mipbake.prefilter.search.texel_descent import descend

    began = time.monotonic()
    filter_named(problem.pixel_filter)
    last = problem.last
    if not isinstance(start, Start):
        start = Start(list(start), np.zeros((2, 2 * last + 1)))
    _check_stack(problem, start.levels)
    judge = HeldOut(problem, whole(problem), budget.held_out, [seed, 2])
    before = -_DECIBEL * judge.typical(start.levels)
    open_at = before.min(0) < _SOLVED_DB
    moving = [bool(open_at[max(0, 2 * level - 1) : 2 * level + 2].any()) for level in range(last + 1)]
    levels = [np.array(level, np.float32) for level in start.levels]
    blocks = [block for block in _blocks(problem, budget.window) if any(moving[level] for level in block.levels)]
    lobes = [Lobes(each) for each in lobes_under(problem)] if blocks else []
    rounds, last_gain = 0, np.zeros(last + 1)
    for index, block in enumerate(blocks):
        deadline = math.inf
        if budget.seconds is not None:
            now = time.monotonic()
            deadline = now + max(0.0, began + budget.seconds - now) / (len(blocks) - index)
        done = descend(
            problem,
            levels,
            block,
            moving,
            lobes,
            start.ahead,
            budget,
            np.random.default_rng([seed, 3, index]),
            deadline,
            lambda share, done=index: progress((done + share) / len(blocks)),  # type: ignore[misc]
        )
        rounds += done.rounds
        inside = slice(block.levels.start, block.levels.stop)
        last_gain[inside] = np.maximum(last_gain[inside], done.gains)
    shares = _shares(judge, start, levels, problem.target)
    kept = _blended(start.levels, levels, shares, problem.target)
    after = -_DECIBEL * judge.typical(kept)
    progress(1.0)
    return Refined(
        kept,
        np.array(judge.lods),
        before,
        after,
        tuple(shares),
        last_gain * np.array(moving),
        rounds,
        time.monotonic() - began,
    )


def lobes_under(problem: Problem) -> list[list[Image]]:
    """Two stacks of `gltf` whose lobes cover the lobes under a texel: the lobe of the mean material, and a wide lobe of
    all."""
    from mipbake.prefilter import METHODS

    return [
        METHODS[name](problem.stored, problem.source, "gltf", problem.pixel_filter, problem.wrap, lambda _: None).levels
        for name in ("linear", "lean")
    ]


def _check_stack(problem: Problem, start: Sequence[Image]) -> None:
    channels = model_named(problem.target).channels
    expected = [(*size, channels) for size in problem.sizes]
    got = [np.shape(level) for level in start]
    if got != expected:
        raise UsageError(f"start has levels of shapes {got}: expected {expected}, every level of {problem.target}")
    if not all(np.isfinite(level).all() for level in start):
        raise UsageError("start holds values that are not finite: expected valid stored channels")


def _blocks(problem: Problem, window: int) -> list[Region]:
    """The coarse levels as a whole, then windows of the fine ones that are larger than a window."""
    sizes = problem.sizes
    fine = sum(max(size) > window for size in sizes)
    blocks = [Region(0, 1, 0, 1, range(fine, len(sizes)))]
    if fine:
        rows, columns = (-(-n // window) for n in sizes[0])
        top, left = np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1)
        blocks += [
            Region(float(top[i]), float(top[i + 1]), float(left[j]), float(left[j + 1]), range(fine))
            for i in range(rows)
            for j in range(columns)
        ]
    return blocks


def _blended(start: Sequence[Image], end: Sequence[Image], shares: Sequence[float], model: str) -> list[Image]:
    """start + share (end - start), level by level; exact at both ends."""

    def one(first: Image, second: Image, share: float) -> Image:
        if share in (0.0, 1.0):
            return np.array(second if share else first, np.float32)
        return material.regularise(first + np.float32(share) * (second - first), model)

    return [one(*each) for each in zip(start, end, shares, strict=True)]


def _shares(judge: HeldOut, start: Start, end: Sequence[Image], model: str) -> list[float]:
    """The share of each level's change that is kept, so that no lod and no pair set is worse off than at the start.

    Levels are settled one after the other, twice: a lod between two levels sees both. Where the mean over sets of pairs
    is then still worse by more than its standard error, the levels around keep less.
    """
    last = len(start.levels) - 1
    near = [range(max(0, 2 * level - 1), min(2 * last, 2 * level + 1) + 1) for level in range(last + 1)]
    initial = [judge.log_errors(start.levels, index) for index in range(2 * last + 1)]
    changed = [level for level in range(last + 1) if not np.array_equal(start.levels[level], end[level])]
    shares = [float(level in changed) for level in range(last + 1)]
    current = _blended(start.levels, end, shares, model)

    def set_share(level: int, share: float) -> None:
        shares[level] = share
        current[level] = _blended([start.levels[level]], [end[level]], [share], model)[0]

    def excess(index: int) -> NDArray[np.float64]:
        return judge.log_errors(current, index) - initial[index]

    def cost(level: int, share: float) -> float:
        set_share(level, share)
        lost = np.stack([excess(index).mean(-1) for index in near[level]], 1)
        behind = np.maximum(lost + start.ahead[:, near[level]], 0)
        return float((lost + DESCENT.kept_behind * behind).sum())

    for _ in range(2):
        for level in changed:
            costs = [cost(level, share) for share in _SHARES]
            set_share(level, _SHARES[int(np.argmin(costs))])
    while any(shares):
        beyond = []
        for index in range(2 * last + 1):
            lost = excess(index)
            noise = lost.std(-1) / math.sqrt(max(1, lost.shape[1] - 1))
            beyond.append(float((lost.mean(-1) - noise).max()))
        worst = int(np.argmax(beyond))
        around = [level for level in {worst // 2, -(-worst // 2)} if shares[level]]
        if beyond[worst] <= 1e-6 or not around:
            break
        for level in around:
            set_share(level, _SHARES[_SHARES.index(shares[level]) + 1])
    return shares
