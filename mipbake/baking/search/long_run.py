"""What a user decides of a search that takes long: how long it may take, who may stop it, and where it is kept."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from mipbake.base.errors import UsageError

Stop = Callable[[], bool]
"""Is called many times a second; where it says True, a search ends with the best that it has."""


def never() -> bool:
    """The `Stop` of a search that nobody stops."""
    return False


@dataclass(frozen=True)
class LongRun:
    """One run of a long search; it may be resumed by another one.

    Args:
        checkpoint: folder that the search is kept in from time to time, and resumed from; None for nowhere.
        descending: entered while texels are optimised, when there is a stack to keep; yields who may stop that.
        note: takes sentences: where the search is resumed, how long it will take, what is kept of it.
    """

    checkpoint: Path | None = None
    descending: Callable[[], AbstractContextManager[Stop]] = lambda: nullcontext(never)
    note: Callable[[str], None] = lambda _: None


NOT_KEPT = LongRun()
"""The run of a search that is neither stopped nor kept."""


BEST = "best"
"""The budget without a limit: until pairs that nothing is fitted to stop improving."""

_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def seconds_of(budget: str) -> float | None:
    """Seconds of a budget; None for `best`. UsageError for anything that is neither a time above 0 nor that."""
    if budget.strip().lower() == BEST:
        return None
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([smh])\s*", budget.lower())
    seconds = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not seconds > 0:
        raise UsageError(
            f"budget is {budget!r}: expected a time above 0 in seconds, minutes or hours, for example 30s, 2m or 1h, "
            f"or {BEST}"
        )
    return seconds
