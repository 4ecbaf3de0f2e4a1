"""Work on as many threads as mipbake may use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import TypeVar

_T = TypeVar("_T")
_R = TypeVar("_R")

MOSTLY_PYTHON = 2
"""Threads for work in small steps: more wait for Python's lock."""


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


def side_by_side(work: Callable[[_T], _R], items: Iterable[_T]) -> list[_R]:
    """What work in small steps makes of each item, in their order."""
    every = list(items)
    return on_threads(lambda index: work(every[index]), len(every), most=MOSTLY_PYTHON)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Holds the matrix products of NumPy to one thread each, in the whole process.

    A library that shares a product among threads adds up in another order, so the last bits of a sum hang on how many
    cores there are. Whoever decides by such a sum decides otherwise on another machine. What calls many small products
    from threads of its own is also slower with such threads.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
