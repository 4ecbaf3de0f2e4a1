"""Tiles worked on side by side, one on a core.

Networks here are many small calls of torch. A team of torch threads for each call mostly waits for one another; torch
gives Python's lock away while it computes, so whole tiles in threads of their own use the same cores far better.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")

_AHEAD = 2  # results for each worker that may wait to be taken: what is made of a large image does not pile up


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Inside, calls of torch use one thread each, whichever Python thread they come from; the former number after."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_order(work: Callable[[_Item], _Made], items: Iterable[_Item]) -> Iterator[_Made]:
    """work(item) of every item, in their order, as many at a time as torch has threads; all without gradients.

    The results do not depend on that number. An error in one ends all with it.
    """
    workers = torch.get_num_threads()

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
