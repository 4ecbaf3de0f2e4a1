"""How long the phases of a piece of work take."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

Progress = Callable[[float], None]
"""Takes the finished share of the work, from 0 to 1."""

PhaseProgress = Callable[[str, float], None]
"""Takes the name of the phase and its finished share, from 0 to 1."""


@dataclass
class Timings:
    """Progress of a piece of work, and how long each of its phases took: the time since the one before ended.

    Args:
        show: takes the phase at work, its finished share, and the seconds that are left, where these are known.
        note: takes how good the result is by now.
        seconds: phase to its time.
    """

    show: Callable[..., None] = lambda *_: None
    note: Callable[[str], None] = lambda _text: None
    seconds: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def __call__(self, phase: str, share: float, left: float | None = None) -> None:
        """Progress as the library reports it: the name of the phase, its finished share, from 0 to 1, and the seconds
        that are left of all phases, where these are known."""
        self.show(phase, share, *(() if left is None else (left,)))
        if share >= 1:
            now = time.perf_counter()
            self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._last
            self._last = now

    def summary(self) -> str:
        """`read 0.1 s, prefilter 2.3 s, ...`."""
        return ", ".join(f"{phase} {seconds:.2f} s" for phase, seconds in self.seconds.items())
