"""Steps of stochastic gradients, and checks on views that are held out (Deliot et al. 2024, section 5)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import stochastic
from mipbake.base.errors import UsageError
from mipbake.fitting.parameters import Parameters
from mipbake.fitting.prepared import Prepared, decibels, gains_of_levels, scores, started, worth
from mipbake.fitting.renderer import Array, Levels, Renderer, Stamps, Tiles
from mipbake.fitting.schedule import Clock
from mipbake.fitting.state import FitFile, FitState
from mipbake.stack.stack import MipStack

_STEPS = 2000  # where neither steps nor a budget are given
_PATIENCE = 3  # checks without a gain of a level, after which its rate is halved
_LEAST_RATE = 1 / 64  # a level whose factor of the rate would be smaller is left as it is
_LAST_RATE = 0.05  # factor that the rate falls to at the end of a budget
_SAVING = 10.0  # times as long as the state took to be kept, steps go on before it is kept again
_ALL, _NONE = slice(None), slice(0)  # tiles

MOST = 4096
"""Renders of a step, and views at a level of detail, at most: far more than any fit gains by."""


def check_count(name: str, number: int) -> None:
    """UsageError for a number of renders or of views that no fit can have."""
    if not 1 <= number <= MOST:
        raise UsageError(f"{name} is {number}: expected 1 to {MOST}")


@dataclass(frozen=True)
class FitSettings:
    """How a fit goes on; `fit` says what the fields are. UsageError: values that make no sense."""

    steps: int | None = None
    budget: float | None = None
    renders: int = 1
    rate: float = 1.0
    passes: int | None = None
    seed: int = 0
    rounds: int = 1

    def __post_init__(self) -> None:
        for name, least in (("steps", 0), ("rounds", 0), ("passes", 1)):
            number = getattr(self, name)
            if number is not None and number < least:
                raise UsageError(f"{name} is {number}: expected {least} or more")
        check_count("renders", self.renders)
        if self.budget is not None and not (isinstance(self.budget, (int, float)) and self.budget > 0):
            raise UsageError(f"budget is {self.budget!r}: expected seconds as a number, more than 0")
        if not 0 < self.rate < math.inf:
            raise UsageError(f"rate is {self.rate}: expected more than 0")
        if not 0 <= self.seed < 2**32:
            raise UsageError(f"seed is {self.seed}: expected 0 to 2^32 - 1")

    @property
    def last(self) -> int | None:
        """The number of steps at which a fit ends; None where its budget alone says when."""
        return _STEPS if self.steps is None and self.budget is None else self.steps

    def stepped(self, step: int) -> float:
        """How much of the steps is made, from 0 to 1; 0 where their number has no end."""
        return 0.0 if self.last is None else 1.0 if self.last == 0 else min(1.0, step / self.last)


@dataclass(frozen=True)
class Progress:
    """What a fit tells of itself after each check.

    Args:
        share: of the whole fit that is done, from 0 to 1.
        step, seconds: so far.
        moving: how many levels still gain.
        scores: mean SNR in dB of held-out views, by scale, now. What is kept may be better.
        gains: of each level in dB so far, over the views that show it, where losses count several times.
        stack: makes the stack as it is kept so far.
    """

    share: float
    step: int
    seconds: float
    moving: int
    scores: Mapping[str, float]
    gains: Sequence[float]
    stack: Callable[[], MipStack]


class Loop:
    """Steps and checks of a fit.

    Args:
        clock: what says when steps end. file: where the state is kept after a check, unless that takes too long.
        tell: called after each check with the state, and with the scores of held-out views.
    """

    def __init__(
        self,
        renderer: Renderer[Any],
        parameters: Parameters,
        wrap: tuple[str, str],
        settings: FitSettings,
        clock: Clock,
        file: FitFile,
        tell: Callable[[FitState, Mapping[str, float]], None],
    ) -> None:
        self.renderer, self.parameters, self.settings = renderer, parameters, settings
        self.clock, self.file, self.tell = clock, file, tell
        self._wrap, self.stamps = wrap, Stamps(parameters.sizes)

    def levels(self, values: Array, tiles: Tiles = _ALL) -> Levels:
        """What the renderer gets of values that differ in these tiles alone from what it gets before and after."""
        self.stamps.touch(tiles)
        levels = self.parameters.levels(values, self._wrap, self.stamps.now())
        self.stamps.touch(tiles)
        return levels

    def errors(self, levels: Levels, views: Sequence[Prepared]) -> NDArray[np.float64]:
        """(views, 2) the errors of each view."""
        return np.stack([view.errors(view.rendered(self.renderer, levels)) for view in views])

    def compared(self, levels: Levels, view: Prepared) -> Array:
        """(P, 6) what is compared of a view, as the renderer shows it."""
        return view.compared(view.rendered(self.renderer, levels))

    def chosen(self, variants: Sequence[Array], views: Sequence[Prepared]) -> NDArray[np.int64]:
        """(levels,) number of the variant that each level is taken from: the one that the views gain most with, or the
        first one where they lose by it, beside the other levels that were chosen."""
        found = [self.errors(self.levels(each), views) for each in variants]
        gains = np.stack([gains_of_levels(views, found[0], each) for each in found])  # NaN: no view shows a level
        chosen = np.argmax(np.nan_to_num(gains), 0)
        joined = self.parameters.joined(variants, chosen)
        kept = self.without_losses(joined, variants[0], views)
        own = map(self.parameters.texels, range(len(chosen)))
        return np.where([np.array_equal(kept[each], joined[each]) for each in own], chosen, 0)

    def without_losses(self, best: Array, start: Array, checking: Sequence[Prepared]) -> Array:
        """The best values, less the levels without which the views that are held out gain more: levels were kept one
        by one, each beside others than it has in the end."""
        kept: Array = best.copy()
        errors = self.errors(self.levels(kept), checking)
        value = _gain(errors, checking)
        for level in range(len(self.parameters.sizes)):
            own = self.parameters.texels(level)
            if np.array_equal(best[own], start[own]):
                continue
            kept[own] = start[own]
            showing = [index for index, view in enumerate(checking) if view.shares[level] > 0]
            others = errors.copy()
            if showing:
                levels = self.levels(kept, self.stamps.level(level))
                others[showing] = self.errors(levels, [checking[index] for index in showing])
            other = _gain(others, checking)
            if other > value:
                errors, value = others, other
            else:
                kept[own] = best[own]
        return kept

    def judge_anew(self, state: FitState, begun: Array, checking: Sequence[Prepared]) -> dict[str, float]:
        """Judges what is kept by more views, or by views whose references have less noise, and returns its scores.

        A level that they lose by is given up: it is as it `begun`. One whose gain is no longer sure is kept, because it
        was chosen when it was. Levels that had stopped move again.
        """
        state.begun, state.started = self.errors(self.levels(begun), checking), started(checking)
        found = self.errors(self.levels(state.best), checking)
        gains = gains_of_levels(checking, state.begun, found)
        state.gains = np.nan_to_num(np.maximum(gains, 0.0))
        state.rates, state.waited[...] = np.where(np.isnan(gains), 0.0, 1.0), 0
        lost = gains_of_levels(checking, state.begun, found, sure=False) < 0
        for level in np.flatnonzero(lost).tolist():
            own = self.parameters.texels(level)
            state.best[own] = begun[own]
        return scores(checking, found)

    def run(
        self, state: FitState, training: Sequence[Prepared], checking: Sequence[Prepared], until: float, end: float
    ) -> None:
        """Steps until a share of the budget or the steps are spent, or until no level gains any more. The state is kept
        where the renderer fails.

        Args:
            training, checking: views to learn from, and those that are held out.
            until, end: shares of the budget at which these steps, and all steps, end.
        """
        settings, clock, gradient = self.settings, self.clock, np.zeros_like(state.values)
        sides = (state.values.copy(), state.values.copy())
        saved, saving = -math.inf, 0.0

        def over() -> bool:
            return settings.stepped(state.step) >= 1 or clock.left(until) <= 0

        def unchecked() -> bool:
            return state.step > state.checked and (state.step - state.turned >= len(training) or over())

        while (not over() or unchecked()) and state.rates.any():
            order = np.random.default_rng([settings.seed, state.turned]).permutation(len(training))
            with self.file.keeping(state):
                for index in () if unchecked() else order[state.step - state.turned :]:
                    done = max(settings.stepped(state.step), clock.share / end if clock.budget else 0.0)
                    falling = _LAST_RATE + (1 - _LAST_RATE) * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))
                    self._step(state, training[index], gradient, sides, settings.rate * falling)
                    state.seconds = clock.seconds
                    clock.stepped(settings.stepped(state.step))
                    if over():
                        break
                now = self._check(state, checking, sides)
                state.checked, state.seconds = state.step, clock.seconds
                if state.step - state.turned >= len(training):
                    state.turned = state.step
            ends = over() or not state.rates.any()
            if ends or state.seconds - saved > _SAVING * saving:
                saved = clock.seconds
                self.file.save(state)
                saving = clock.seconds - saved
            self.tell(state, now)

    def _step(self, state: FitState, view: Prepared, gradient: Array, sides: tuple[Array, Array], rate: float) -> None:
        """Moves the texels that a view shows. `sides` have the same values before and after."""
        channels, settings = self.parameters.channels, self.settings
        for index in range(settings.renders):
            number = state.step * settings.renders + index + 1
            stochastic.perturb(state.values, channels, number, settings.seed, view.visible, sides)
            images = [self.compared(self.levels(side, view.tiles), view) for side in sides]
            differences = stochastic.pixel_differences(images[0], images[1], view.wanted, view.shown)
            stochastic.add_gradient(gradient, differences, view.read, channels, number, settings.seed)
        bounds = np.searchsorted(view.visible, self.parameters.starts)
        for level in np.flatnonzero(view.shares):
            own = view.visible[bounds[level] : bounds[level + 1]]
            factor = rate * float(state.rates[level])
            stochastic.descend(state.values, gradient, state.moments, channels, factor, own)
        state.step += 1
        for side in sides:
            side[view.visible] = state.values[view.visible]

    def _check(self, state: FitState, checking: Sequence[Prepared], sides: tuple[Array, Array]) -> dict[str, float]:
        """Keeps the levels that are the best so far, and lowers the rate of those that were not for some time."""
        found = self.errors(self.levels(state.values, _NONE), checking)
        for level, gain in enumerate(gains_of_levels(checking, state.begun, found)):
            own = self.parameters.texels(level)
            if gain > state.gains[level]:
                state.best[own], state.gains[level], state.waited[level] = state.values[own], gain, 0
                continue
            state.waited[level] += 1
            if state.waited[level] >= _PATIENCE:
                halved = state.rates[level] / 2
                state.rates[level], state.waited[level] = halved if halved >= _LEAST_RATE else 0.0, 0
                for array in (state.values, *sides):
                    array[own] = state.best[own]
                self.stamps.touch(self.stamps.level(level))
        return scores(checking, found)


def _gain(errors: NDArray[np.float64], views: Sequence[Prepared]) -> float:
    """What is gained since the start, as `worth` has it, in the mean over scales."""
    gained = decibels(errors) - decibels(np.array([view.started for view in views]))
    scales = sorted({view.scale for view in views})
    of_scales = [gained[[view.scale == scale for view in views]].mean(0) for scale in scales]
    return float(worth(np.array(of_scales)).mean())
