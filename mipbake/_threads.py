"""Work on as many threads as mipbake may use."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import TypeVar

_T = TypeVar("_T")


def threads() -> int:
    """How many threads a kernel, or what calls kernels, may use, the caller included."""
    from mipbake import _native

    return _native.num_threads()


def on_threads(
    work: Callable[[int], _T],
    count: int,
    progress: Callable[[float], None] = lambda _: None,
    most: int | None = None,
) -> list[_T]:
    """work(0), work(1), ... on several threads, and what they return, in this order.

    Args:
        progress: told the finished share, below 1, from the thread of the caller.
        most: threads; None for as many as there may be.
    """
    workers = min(count, most or threads())
    if workers <= 1:
        done = []
        for index in range(count):
            done.append(work(index))
            progress((index + 1) / (count + 1))
        return done
    with ThreadPoolExecutor(workers) as pool:
        waiting = [pool.submit(work, index) for index in range(count)]
        try:
            for index, each in enumerate(as_completed(waiting)):
                each.result()
                progress((index + 1) / (count + 1))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
        return [each.result() for each in waiting]
