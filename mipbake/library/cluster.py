"""The tasks of a batch on the machines of a Ray cluster.

Machines that see the same files read and write them themselves. Where one does not, sources are sent to it and results
are sent back. A machine or a process that dies keeps nothing from being baked: what it was about is begun elsewhere.
"""

from __future__ import annotations

import logging
import os
import platform
import signal
import socket
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from mipbake import _native
from mipbake.baking.results import NotBaked
from mipbake.base import memory
from mipbake.base.allocator import keep_freed_memory
from mipbake.base.errors import MipbakeError, OutputError, UsageError
from mipbake.base.extras import extra
from mipbake.base.leftovers import begun, tidy
from mipbake.base.publish import reason
from mipbake.base.version import __version__
from mipbake.library.parcels import Delivery, Parcel, absolute, as_named, baked_from, packed, unpacked
from mipbake.library.results import WorkerError
from mipbake.library.state import FOLDER, FileState, states
from mipbake.library.task import Done, Task, unforeseen, work
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
        work: a task for who sees the same files, or a parcel.
        mark: a file beside the results, which only those see. files: of the source, as they are seen here.
    """

    version: str
    share: int
    memory: int | None
    work: Task | Parcel
    mark: Path
    files: tuple[tuple[str, int], ...] = ()


Answer = Done | list[Delivery] | Literal["apart", "unlike"]
"""What came of an order. "apart": the machine does not see where results belong. "unlike": it does, but it does not see
the same files of the source."""


class Cluster:
    """Does tasks on a cluster, as `mipbake.library.workers.Workers` does on one machine."""

    def __init__(self, jobs: int | None, limit: int | None, mark: Path) -> None:
        self._jobs = jobs
        self._limit = limit
        self._mark = mark
        self._apart = False

    def processes(self, count: int) -> int:
        """How many processes there are for so many tasks, as the cluster is now."""
        sizes = _sizes()
        return max(1, min(self._jobs or count, count, _fitting(sizes, self._threads(sizes, count))))

    def done(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Done]]:
        """Tasks with what was done, in the order in which they end.

        Raises:
            UsageError: no machine has as much memory as each process is to hold to.
        """
        ray = _ray()
        waiting = deque((task, False) for task in tasks)
        running: dict[Any, tuple[Task, Sent]] = {}  # without the bytes of parcels, which Ray holds
        threads = self._threads(_sizes(), len(waiting))
        wanted: dict[str, Any] = {"num_cpus": threads, "max_retries": _TRIES, "scheduling_strategy": "SPREAD"}
        if self._limit is not None:
            _check_memory(self._limit)
            wanted["memory"] = self._limit
        follow = ray.remote(**wanted)(followed)
        while waiting or running:
            most = self._jobs or _AHEAD * max(1, _fitting(_sizes(), threads))
            while waiting and len(running) < most:
                task, unlike = waiting.popleft()
                sent = self._sent(task, unlike)
                if isinstance(sent, Done):
                    yield task, sent
                else:
                    order = Order(__version__, threads, self._limit, sent.work, self._mark, sent.seen)
                    running[follow.remote(order)] = task, replace(sent, work=task)
                    del order, sent
            # Ray looks for no signals while it waits.
            ended = ray.wait(list(running), num_returns=1, timeout=_LOOK)[0] if running else []
            for handle in ended:
                task, sent = running.pop(handle)
                answer = _answer(handle)
                if isinstance(answer, str):
                    self._apart = self._apart or answer == "apart"
                    waiting.appendleft((task, True))
                elif isinstance(answer, Done):
                    yield task, as_named(answer, task)
                elif isinstance(answer, MipbakeError):
                    yield task, Done((NotBaked(task.entry.source, answer),), None, time.monotonic() - sent.begun)
                else:
                    yield task, unpacked(task, answer, sent.files, sent.begun)

    def _threads(self, sizes: Sequence[int], count: int) -> int:
        """CPUs of a process for so many tasks: the most with which as many processes fit as there shall be."""
        jobs = self._jobs or sum(max(1, size // THREADS) for size in sizes)
        jobs = max(1, min(jobs, count, sum(sizes)))
        return next(threads for threads in range(max(sizes), 0, -1) if _fitting(sizes, threads) >= jobs)

    def _sent(self, task: Task, unlike: bool) -> Sent | Done:
        begun = time.monotonic()
        if not self._apart and not unlike:
            seen = tuple((file.path, file.size) for file in states(task.entry))
            return Sent(absolute(task), begun, seen)
        parcel, files = packed(task)
        return parcel if isinstance(parcel, Done) else Sent(parcel, begun, files=tuple(files))


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


@dataclass(frozen=True)
class Sent:
    """What was given to the cluster.

    Args:
        work: see `Order`. begun: when, by time.monotonic. seen: see `files` of `Order`.
        files: that decide the task of a parcel.
    """

    work: Task | Parcel
    begun: float
    seen: tuple[tuple[str, int], ...] = ()
    files: tuple[FileState, ...] = ()


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
        with _marked(Path(os.path.abspath(out)) / FOLDER / "shared") as mark:  # noqa: PTH100  links stay
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


def _answer(handle: Any) -> Answer | MipbakeError:
    """What came of an order, or why nothing did."""
    ray = _ray()
    try:
        answer: Answer = ray.get(handle)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, MipbakeError):
            return error.cause
        if not isinstance(error.cause, (ImportError, AttributeError, ray.exceptions.RayError)):
            return unforeseen(error.cause)
        return _unfinished(error.cause)
    except ray.exceptions.RayError as error:
        return _unfinished(error)
    return answer


def _unfinished(error: Exception) -> WorkerError:
    told = [line for line in str(error).splitlines() if line.strip()]
    return WorkerError(
        f"no process of the cluster has finished it ({type(error).__name__}: {told[0].strip() if told else ''}): see "
        f"that mipbake {__version__} is installed on all machines, and hold processes to less (--memory) where memory "
        "ran out"
    )


def followed(order: Order) -> Answer:
    """Follows an order, in a process of the cluster.

    Raises:
        UsageError: another version of mipbake is installed there.
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
            if isinstance(order.work, Parcel):
                return baked_from(order.work)
            if not order.mark.exists():
                return "apart"
            return work(order.work) if _sees(order, order.work) else "unlike"
        finally:
            tempfile.tempdir = before


def _sees(order: Order, task: Task) -> bool:
    """Whether this machine sees the files of a task."""
    return order.files == tuple((file.path, file.size) for file in states(task.entry))


def _own_size() -> int:
    """CPUs that this machine has for the cluster."""
    own = _ray().get_runtime_context().get_node_id()
    return next((int(node["Resources"].get("CPU", 1)) for node in _nodes() if node["NodeID"] == own), 1)
