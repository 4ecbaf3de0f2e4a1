"""Time budgets as users write them: `30s`, `2m`, `1h`, `best`."""

from __future__ import annotations

import re

from mipbake.base.errors import UsageError

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
