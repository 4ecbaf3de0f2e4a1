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
from collections.abc import Iterable, Iterator, Sequence
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
        sizes = _sizes()
        return max(1, min(self._jobs or count, count, _fitting(sizes, self._threads(sizes, count))))

    def done(self, tasks: Iterable[Task]) -> Iterator[EntryResult]:
        """What became of tasks, in the order in which they end.

        Raises:
            UsageError: no machine has as much memory as each process is to hold to.
        """
        ray = _ray()
        waiting = deque(tasks)
        running: dict[Any, Task] = {}
        threads = self._threads(_sizes(), len(waiting))
        wanted: dict[str, Any] = {"num_cpus": threads, "max_retries": _TRIES, "scheduling_strategy": "SPREAD"}
        if self._limit is not None:
            _check_memory(self._limit)
            wanted["memory"] = self._limit
        follow = ray.remote(**wanted)(followed)
        while waiting or running:
            most = self._jobs or _AHEAD * max(1, _fitting(_sizes(), threads))
            while waiting and len(running) < most:
                task = waiting.popleft()
                order = Order(__version__, threads, self._limit, task, Path.cwd(), self._mark, _seen(task))
                running[follow.remote(order)] = task
            # Ray looks for no signals while it waits.
            for handle in ray.wait(list(running), num_returns=1, timeout=_LOOK)[0]:
                yield _answer(handle, running.pop(handle))

    def _threads(self, sizes: Sequence[int], count: int) -> int:
        """CPUs of a process for so many tasks: the most with which as many processes fit as there shall be."""
        jobs = self._jobs or sum(max(1, size // THREADS) for size in sizes)
        jobs = max(1, min(jobs, count, sum(sizes)))
        return next(threads for threads in range(max(sizes), 0, -1) if _fitting(sizes, threads) >= jobs)


def _fitting(sizes: Sequence[int], threads: int) -> int:
    """How many processes of so many CPUs fit on machines."""
    return sum(size // threads for size in sizes)


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
            told = str(error).strip().partition("\n")[0].rstrip(".")
            raise UsageError(
                f"no Ray cluster can be used at {address} ({told}): start one with `ray start --head` and name its "
                "HOST:PORT, or `auto` on a machine of the cluster"
            ) from error
    try:
        with _marked(Path(absolute(out)) / FOLDER / "shared") as mark:
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


@contextmanager
def _marked(place: Path) -> Iterator[Path]:
    """A file that who sees the same files sees."""
    with ExitStack() as mark:
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            tidy(place)
            path = mark.enter_context(begun(place, lambda path: path.touch(exist_ok=False)))
        except OSError as error:
            raise OutputError(f"cannot write to {place.parent}: {reason(error)}") from error
        yield path


def _answer(handle: Any, task: Task) -> EntryResult:
    """What came of an order, or why nothing did."""
    ray = _ray()
    failure: MipbakeError
    try:
        result: EntryResult = ray.get(handle)
        return result
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, MipbakeError):
            failure = error.cause
        elif not isinstance(error.cause, (ImportError, AttributeError, ray.exceptions.RayError)):
            failure = unforeseen(error.cause)
        else:
            failure = _unfinished(error.cause)
    except ray.exceptions.RayError as error:
        failure = _unfinished(error)
    return EntryResult(task.entry, (NotBaked(task.entry.source, failure),))


def _unfinished(error: Exception) -> WorkerError:
    told = [line for line in str(error).splitlines() if line.strip()]
    return WorkerError(
        f"no process of the cluster has finished it ({type(error).__name__}: {told[0].strip() if told else ''}): see "
        f"that mipbake {__version__} is installed on all machines, and hold processes to less (--memory) where memory "
        "ran out"
    )


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
    if order.memory is None:
        whole = memory.default()
        limit = None if whole is None else whole * order.share // max(order.share, _own_size())
    else:
        limit = order.memory
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
    with suppress(OSError):  # then paths are told apart by what lies there
        os.chdir(order.folder)
    source = order.task.entry.source
    lost = order.mark.parent.parent if not order.mark.exists() else source if _seen(order.task) != order.files else None
    if lost is not None:
        raise InputError(
            f"{platform.node()} does not see {lost} as the machine does that has begun the batch: give all machines "
            "of the cluster the sources and the folder of all results under the same paths, or bake with --shard"
        )


def _seen(task: Task) -> tuple[tuple[str, int], ...]:
    """The files of a source, with their sizes, as this machine sees them."""
    return tuple((file.path, file.size) for file in states(task.entry))


def _own_size() -> int:
    """CPUs that this machine has for the cluster."""
    own = _ray().get_runtime_context().get_node_id()
    return next((int(node["Resources"].get("CPU", 1)) for node in _nodes() if node["NodeID"] == own), 1)
