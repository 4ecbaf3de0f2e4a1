"""How a fit spends its time: one clock for everything that it does, from the first render to the last."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from mipbake.fitting.program import Frame
from mipbake.fitting.renderer import Levels, Renderer

# Shares of a budget.
FIRST = 0.03  # at most goes by before there is a start: views with coarse references
# Of what comes before CLOSING, at which stages of steps end: a first stack is there early.
STAGES = (0.1, 0.25, 0.5, 1.0)
GROWING = 0.4  # of each later stage at most is for more views, and for references with less noise
ROUNDS = 0.25  # at most is for rounds of least squares
CLOSING = 0.9  # from here on, the result is judged by views that nothing was learned from or chosen by
LAST = 0.98  # here, what is known of these views is what counts

# Without a budget the shares of a fit at which its views are there, and its steps are done: a guess.
_PREPARED, _STEPPED = 0.3, 0.9

TICK = 1e-6  # seconds that anything takes at least: some systems' clocks stand still for milliseconds


class Clock:
    """How much of a fit is done: of its budget, or else of its views and steps.

    Args:
        budget: seconds for everything; None for as long as it takes.
        told: called after each render with the share that is done, and with the seconds that are left, or None.
    """

    def __init__(self, budget: float | None, told: Callable[[float, float | None], None]) -> None:
        self.budget, self._told = budget, told
        self._begun = time.monotonic()
        self._done = 0.0

    def resume(self, seconds: float) -> None:
        """Sets the clock to what it showed when a fit was kept."""
        self._begun = time.monotonic() - seconds

    @property
    def seconds(self) -> float:
        """Spent so far."""
        return time.monotonic() - self._begun

    @property
    def share(self) -> float:
        """From 0 to 1."""
        return self._done if self.budget is None else min(1.0, self.seconds / self.budget)

    def left(self, until: float) -> float:
        """Seconds until a share of the budget is spent; infinite without a budget."""
        return math.inf if self.budget is None else until * self.budget - self.seconds

    def viewed(self, share: float) -> None:
        """So much of the views is prepared."""
        self._done = max(self._done, _PREPARED * share)

    def stepped(self, share: float) -> None:
        """So much of the steps is done."""
        self._done = max(self._done, _PREPARED + (_STEPPED - _PREPARED) * share)

    def tick(self) -> None:
        """Tells how much is done."""
        self._told(self.share, None if self.budget is None else max(0.0, self.budget - self.seconds))


class Timed:
    """A renderer after each of whose frames the clock tells how much is done."""

    def __init__(self, renderer: Renderer[Any], clock: Clock) -> None:
        self._renderer, self._clock = renderer, clock

    def render(self, levels: Levels, view: Any) -> Frame:
        frame: Frame = self._renderer.render(levels, view)
        self._clock.tick()
        return frame
