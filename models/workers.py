"""Tiles worked on side by side, one on a core.

Networks here are many small calls of torch. A team of torch threads for each call mostly waits for one another; torch
gives Python's lock away while it computes, so whole tiles in threads of their own use the same cores far better.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")

_MOST = 16  # workers: each holds tens of megabytes; a guess
_AHEAD = 2  # results for each worker that may wait to be taken: what is made of a large image does not pile up; a guess


class _Alone:
    """Who is inside of `one_torch_thread`, and how many threads torch had before anybody was.

    torch keeps one number for the process, which new threads start with, and one number for each thread. So users who
    overlap share one number to go back to: the second user finds the number that the first user has set.
    """

    def __init__(self) -> None:
        self._lock, self._own = threading.Lock(), threading.local()
        self._inside, self._before = 0, 1

    def enter(self) -> None:
        depth = getattr(self._own, "depth", 0)
        self._own.depth = depth + 1
        if depth:
            return
        with self._lock:
            if not self._inside:
                self._before = torch.get_num_threads()
            self._inside += 1
            torch.set_num_threads(1)

    def leave(self) -> None:
        self._own.depth -= 1
        if self._own.depth:
            return
        with self._lock:
            self._inside -= 1
            torch.set_num_threads(self._before)


_alone = _Alone()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Inside, calls of torch use one thread each, here and in threads that start meanwhile; the former number after."""
    _alone.enter()
    try:
        yield
    finally:
        _alone.leave()


def in_order(work: Callable[[_Item], _Made], items: Iterable[_Item]) -> Iterator[_Made]:
    """work(item) of every item, in their order, as many at a time as torch has threads, 16 at most; without gradients.

    The results do not depend on that number. An error in one ends all with it.
    """
    workers = min(torch.get_num_threads(), _MOST)

    def quietly(item: _Item) -> _Made:
        with torch.inference_mode():  # which each thread enters for itself
            return work(item)

    if workers == 1:
        yield from map(quietly, items)
        return
    with one_torch_thread(), ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[_Made]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(quietly, item))
                if len(waiting) >= _AHEAD * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for each in waiting:
                each.cancel()
