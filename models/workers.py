"""Tiles worked on side by side, one on a core; or one after the other, on a graphics card.

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

from mipbake.base.errors import UsageError

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")

_MOST = 16  # workers: each holds tens of megabytes
_PROCESSOR = torch.device("cpu")
_AHEAD = 2  # results for each worker that may wait to be taken: what is made of a large image does not pile up


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


@contextmanager
def baking_on(device: torch.device) -> Iterator[None]:
    """Inside, torch calculates without gradients, and on a graphics card in float32 throughout.

    Raises:
        UsageError: the memory of the graphics card is too small for what is done inside.
    """
    with torch.inference_mode():
        if device.type == _PROCESSOR.type:
            yield
            return
        try:
            # Convolutions there would round their factors to 10 bits, which is torch's default.
            with torch.backends.cudnn.flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False):
                yield
        except torch.OutOfMemoryError as error:
            raise UsageError(
                f"the memory of the device {device} is too small to bake this set: leave the device out to bake on the "
                "processor"
            ) from error


def in_order(
    work: Callable[[_Item], _Made], items: Iterable[_Item], device: torch.device = _PROCESSOR
) -> Iterator[_Made]:
    """work(item) of every item, in their order, as many at a time as torch has threads, 16 at most; without gradients.

    The results do not depend on that number. An error in one ends all with it. On another `device` than the processor
    it is one item after the other, in the thread that asks: each fills the whole device.
    """
    workers = min(torch.get_num_threads(), _MOST) if device.type == _PROCESSOR.type else 1

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
