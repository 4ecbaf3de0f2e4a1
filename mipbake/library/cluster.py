"""The tasks of a batch on the machines of a Ray cluster.

All machines read and write the same files under the same paths; no file goes through Ray. A machine or a process that
dies keeps nothing from being baked: what it was about is begun elsewhere.
"""

from __future__ import annotations

import logging
import os
import platform
import signal
import socket
import tempfile
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake import _native
from mipbake.baking.results import NotBaked
from mipbake.base import memory
from mipbake.base.allocator import keep_freed_memory
from mipbake.base.errors import InputError, MipbakeError, OutputError, UsageError
from mipbake.base.extras import extra
from mipbake.base.leftovers import begun, tidy
from mipbake.base.publish import reason
from mipbake.base.version import __version__
from mipbake.library.results import EntryResult, WorkerError
from mipbake.library.state import FOLDER, absolute, states
from mipbake.library.task import Task, unforeseen, work
from mipbake.library.workers import end_at_once

THREADS = 4
"""CPUs of a process, where the number of processes is not said."""

_TRIES = 2
"""How often a task whose process or machine died is begun again."""

_AHEAD = 2
"""Tasks that wait, as a multiple of those that run, so that no machine waits and one that joins has something to do."""

_LOOK = 0.5
"""Seconds after which it is looked for signals."""

_PATIENCE = 10
"""Seconds in which the head of a cluster must answer."""

_LEFT = "mipbake-work"
"""Name of temporary folders, which are tidied up where a process died."""


@dataclass(frozen=True)
class Order:
    """What a process of a cluster is asked to do.

    Args:
        version: of mipbake here. share: CPUs that it may use. memory: bytes that it is held to; None for its part of
            what mipbake takes of a machine.
        folder: the working directory here, which paths of the task may be relative to.
        mark: a file beside the results. files: of the source, with their sizes. Both are as they are seen here.
    """

    version: str
    share: int
    memory: int | None
    task: Task
    folder: Path
    mark: Path
    files: tuple[tuple[str, int], ...] = ()


class Cluster:
    """Does tasks on a cluster, as `mipbake.library.workers.Workers` does on one machine."""

    def __init__(self, jobs: int | None, limit: int | None, mark: Path) -> None:
        self._jobs = jobs
        self._limit = limit
        self._mark = mark

    def processes(self, count: int) -> int:
        """How many processes there are for so many tasks, as the cluster is now."""
        return max(1, min(self._jobs or count, count, _fitting(self._threads(count))))

    def done(self, tasks: Iterable[Task]) -> Iterator[EntryResult]:
        """What became of tasks, in the order in which they end.

        Raises:
            UsageError: no machine has as much memory as each process is to hold to.
        """
        ray = _ray()
        waiting = deque(tasks)
        running: dict[Any, Task] = {}
        threads = self._threads(len(waiting))
        wanted: dict[str, Any] = {"num_cpus": threads, "max_retries": _TRIES, "scheduling_strategy": "SPREAD"}
        if self._limit is not None:
            _check_memory(self._limit)
            wanted["memory"] = self._limit
        follow = ray.remote(**wanted)(followed)
        while waiting or running:
            most = self._jobs or _AHEAD * max(1, _fitting(threads))
            while waiting and len(running) < most:
                task = waiting.popleft()
                order = Order(__version__, threads, self._limit, task, Path.cwd(), self._mark, _seen(task))
                running[follow.remote(order)] = task
            # Ray looks for no signals while it waits.
            for handle in ray.wait(list(running), num_returns=1, timeout=_LOOK)[0]:
                yield _answer(handle, running.pop(handle))

    def _threads(self, count: int) -> int:
        """CPUs of a process for so many tasks: the most with which as many processes fit as there shall be."""
        sizes = _sizes()
        jobs = self._jobs or sum(max(1, size // THREADS) for size in sizes)
        jobs = max(1, min(jobs, count, sum(sizes)))
        return next(threads for threads in range(max(sizes), 0, -1) if _fitting(threads) >= jobs)


def _fitting(threads: int) -> int:
    """How many processes of so many CPUs fit on the machines."""
    return sum(size // threads for size in _sizes())


def _check_memory(limit: int) -> None:
    most = max((int(node["Resources"].get("memory", 0)) for node in _nodes()), default=0)
    if most < limit:
        raise UsageError(
            f"each process is to hold to {memory.told(limit)}, and the largest machine of the cluster gives "
            f"{memory.told(most)}: give less with --memory, or leave it out"
        )


def _ray() -> Any:
    """The library; UsageError where it is not installed."""
    with extra("cluster", "--cluster"):
        import ray
    return ray


def _sizes() -> list[int]:
    """CPUs of each machine."""
    return [cpus for node in _nodes() if (cpus := int(node["Resources"].get("CPU", 0)))] or [1]


def _nodes() -> list[dict[str, Any]]:
    """What Ray says of each machine that is there."""
    return [node for node in _ray().nodes() if node["Alive"]]


@contextmanager
def cluster(address: str, jobs: int | None, limit: int | None, out: Path) -> Iterator[Cluster]:
    """A cluster that does tasks. What it is about is not finished when the block raises.

    Args:
        address: "auto" for the cluster that this machine belongs to; HOST:PORT of a head, or ray://HOST:PORT.
        jobs: how many tasks are done at once; None for as many as fit.
        limit: bytes that each process is held to; None for its part of what mipbake takes of a machine.
        out: folder of all results.

    Raises:
        UsageError: Ray is not installed, or no cluster answers. OutputError: the folder cannot be written.
    """
    ray = _ray()
    own = not ray.is_initialized()
    if own:
        try:
            _check_address(address)
            with _own_signals():
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (OSError, ValueError, RuntimeError, AssertionError, ImportError) as error:
            why = str(error).strip().partition("\n")[0].rstrip(".")
            raise UsageError(
                f"no Ray cluster can be used at {address} ({why}): start one with `ray start --head` and name its "
                "HOST:PORT, or `auto` on a machine of the cluster"
            ) from error
    try:
        # Who sees the same files sees this one.
        place = Path(absolute(out)) / FOLDER / "shared"
        with ExitStack() as held:
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                tidy(place)
                mark = held.enter_context(begun(place, lambda path: path.touch(exist_ok=False)))
            except OSError as error:
                raise OutputError(f"cannot write to {place.parent}: {reason(error)}") from error
            yield Cluster(jobs, limit, mark)
    finally:
        if own:
            ray.shutdown()


def _check_address(address: str) -> None:
    """OSError where nothing answers: Ray itself tries for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE).close()


@contextmanager
def _own_signals() -> Iterator[None]:
    """Leaves signals to who has handled them before: Ray takes SIGTERM for itself."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    if before is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, before)


def _answer(handle: Any, task: Task) -> EntryResult:
    """What came of an order, or why nothing did."""
    ray = _ray()
    try:
        result: EntryResult = ray.get(handle)
        return result
    except ray.exceptions.RayError as error:
        cause = error.cause if isinstance(error, ray.exceptions.RayTaskError) else error
    if isinstance(cause, (ImportError, AttributeError, ray.exceptions.RayError)):
        lines = [line for line in str(cause).splitlines() if line.strip()] or [""]
        cause = WorkerError(
            f"no process of the cluster has finished it ({type(cause).__name__}: {lines[0].strip()}): see that mipbake "
            f"{__version__} is installed on all machines, and hold processes to less (--memory) where memory ran out"
        )
    elif not isinstance(cause, MipbakeError):
        cause = unforeseen(cause)
    return EntryResult(task.entry, (NotBaked(task.entry.source, cause),))


def followed(order: Order) -> EntryResult:
    """Follows an order, in a process of the cluster.

    Raises:
        UsageError: another version of mipbake is installed there. InputError: the machine does not see the same files.
    """
    if __version__ != order.version:
        raise UsageError(
            f"{platform.node()} has mipbake {__version__}, and the batch was begun by {order.version}: install the "
            "same version on all machines of the cluster"
        )
    _native.set_num_threads(order.share)
    signal.signal(signal.SIGTERM, lambda *_: end_at_once())
    limit, whole = order.memory, memory.default()
    if limit is None and whole is not None:
        limit = whole * order.share // max(order.share, _own_size())
    keep_freed_memory(limit)
    place = Path(tempfile.gettempdir()) / _LEFT
    before = tempfile.tempdir
    tidy(place)
    with begun(place, Path.mkdir) as scratch, memory.limited(limit):
        tempfile.tempdir = str(scratch)
        try:
            check_files(order)
            return work(order.task)
        finally:
            tempfile.tempdir = before


def check_files(order: Order) -> None:
    """InputError where this machine does not see the files of an order as the one that gave it."""
    with suppress(OSError):  # then what lies at the paths decides
        os.chdir(order.folder)
    if not order.mark.exists():
        lost = order.mark.parent.parent
    elif _seen(order.task) != order.files:
        lost = order.task.entry.source
    else:
        return
    raise InputError(
        f"{platform.node()} does not see {lost} as the machine does that has begun the batch: give all machines of the "
        "cluster the sources and the folder of all results under the same paths, or bake with --shard"
    )


def _seen(task: Task) -> tuple[tuple[str, int], ...]:
    """The files of a source, with their sizes, as this machine sees them."""
    return tuple((file.path, file.size) for file in states(task.entry))


def _own_size() -> int:
    """CPUs that this machine has for the cluster."""
    own = _ray().get_runtime_context().get_node_id()
    return next((int(node["Resources"].get("CPU", 1)) for node in _nodes() if node["NodeID"] == own), 1)
