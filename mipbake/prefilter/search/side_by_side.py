"""Work that is done side by side: NumPy lets go of Python's lock while it calculates, but uses one core."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_T = TypeVar("_T")
_R = TypeVar("_R")

WORKERS = 2
"""Threads of a search. More wait for Python's lock; a guess."""


def side_by_side(work: Callable[[_T], _R], items: Iterable[_T]) -> list[_R]:
    """What work makes of each item, in their order."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(pool.map(work, items))
