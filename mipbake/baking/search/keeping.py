"""What of a descent goes into a checkpoint, and when; and what it goes on with."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

from mipbake.baking.search.blending import Blend
from mipbake.baking.search.checkpoint import Checkpoint
from mipbake.baking.search.kept_search import Come, start_parts
from mipbake.baking.search.regions import TimedRegion, window
from mipbake.baking.search.texel_descent import RegionState
from mipbake.quality.reference.problem import Image, Problem


def windows_in(problem: Problem, regions: Sequence[TimedRegion], index: int) -> Mapping[int, tuple[slice, slice]]:
    """The texels of a region, by its index: level to rows and columns."""
    region = regions[index].region
    return {level: window(region, problem.sizes[level]) for level in region.levels}


class Keeping:
    """Keeps a descent in a checkpoint.

    Args:
        checkpoint: None for nowhere. start: of the descent. regions: all of them.
        levels: of the stack, which the descent changes. come: how far an earlier sitting has come.
        began: time.monotonic() when the search began, earlier sittings included.
    """

    def __init__(
        self,
        checkpoint: Checkpoint | None,
        problem: Problem,
        start: Blend,
        regions: Sequence[TimedRegion],
        levels: list[Image],
        come: Come,
        began: float,
    ) -> None:
        self._checkpoint, self._problem, self._start = checkpoint, problem, start
        self._regions, self._levels, self._began = regions, levels, began
        self._waiting = come if come.state is not None else None
        self.done = set(come.done)

    @property
    def due(self) -> bool:
        """Whether it may be worth to keep something."""
        return self._checkpoint is not None and self._checkpoint.due()

    @property
    def waiting(self) -> int | None:
        """The region that an earlier sitting left, until it is begun."""
        return None if self._waiting is None else self._waiting.at

    def taken(self, index: int) -> RegionState | None:
        """What an earlier sitting left of a region that is begun now; None for nothing."""
        if self._waiting is None or self._waiting.at != index:
            return None
        state, self._waiting = self._waiting.state, None
        return state

    def keep(self, index: int, state: RegionState | None = None, now: bool = False) -> None:
        """Keeps the regions that are done and the state of the region at work, where it is not too soon.

        Args:
            now: keep them whatever that takes.
        """
        if self._checkpoint is None or not (now or self.due):
            return
        come = Come(tuple(sorted(self.done)), index, state)
        if state is None and self._waiting is not None:
            come = replace(self._waiting, done=come.done)
        seconds = time.monotonic() - self._began
        self._checkpoint.keep(lambda: start_parts(self._start), self._levels, self._windows, come, seconds, now)

    def _windows(self, index: int) -> Mapping[int, tuple[slice, slice]]:
        return windows_in(self._problem, self._regions, index)
