"""Processes that do tasks side by side, and share the threads and the memory of the machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType

from mipbake.baking.results import NotBaked
from mipbake.base import memory
from mipbake.base.allocator import keep_freed_memory
from mipbake.base.leftovers import remove, unfinished
from mipbake.base.publish import temporary_folder
from mipbake.library.results import EntryResult, WorkerError
from mipbake.library.task import Task, work

TERMINATED = 143  # what shells make of SIGTERM

_STOPPING = (signal.SIGINT, signal.SIGTERM)
_STARTS = 5
"""How often in a row it is tried to begin a process."""

_HELD = ExitStack()
"""What holds for as long as a process lives."""


@dataclass(frozen=True)
class Share:
    """What one process of a batch may use.

    Args:
        threads: of the native core. memory: bytes; None for no limit.
    """

    threads: int
    memory: int | None

    @classmethod
    def of(cls, jobs: int, threads: int, memory: int | None) -> Share:
        """Its share where there are so many processes."""
        return cls(max(1, threads // jobs), None if memory is None else max(1, memory // jobs))


class Workers:
    """Processes that do tasks. They begin when there is something to do, and stay for what comes next.

    A process may be killed, by what it is about or by somebody else. Then all processes begin anew, because their
    common queue cannot be trusted any more. What they were about is done once more, one task at a time, so that a task
    that ends its process is known.
    """

    def __init__(self, jobs: int, share: Share, scratch: Path) -> None:
        self._jobs = jobs
        self._share = share
        self._scratch = scratch
        self._pool: ProcessPoolExecutor | None = None
        self._lifeline: Connection | None = None

    def processes(self, count: int) -> int:
        """How many processes there are for so many tasks."""
        return min(self._jobs, count)

    def done(self, tasks: Iterable[Task]) -> Iterator[EntryResult]:
        """What became of tasks, in the order in which they end. One whose process dies keeps no other from it."""
        waiting, suspects = deque(tasks), deque[Task]()
        running: dict[Future[EntryResult], Task] = {}
        starts = 0
        while waiting or suspects or running:
            alone = bool(suspects)
            queue, most = (suspects, 1) if alone else (waiting, self._jobs)
            try:
                while queue and len(running) < most:
                    running[self._submitted(queue[0])] = queue[0]
                    queue.popleft()
            except (BrokenProcessPool, OSError) as refused:  # one ended while it began, or none can be begun
                suspects.extend(running.values())
                self.stop()
                running.clear()
                starts += 1
                if starts == _STARTS:
                    yield from (_failed(task, f" ({refused})") for task in (*suspects, *waiting))
                    return
                continue
            starts = 0
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in ended:
                error = future.exception()
                if error is None:
                    del running[future]
                    yield future.result()
                elif not isinstance(error, BrokenProcessPool):
                    yield _failed(running.pop(future), f" ({error})")
            if any(future in running for future in ended):
                self.stop()
                if alone:
                    yield from (_failed(task, ", and so did a second one") for task in running.values())
                else:
                    suspects.extend(running.values())
                running.clear()

    def _submitted(self, task: Task) -> Future[EntryResult]:
        """A task for a process, which may begin now. Signals wait until it does what `_begin` says."""
        pool = self._started()  # before the signals wait: its queues begin a process, and that lets signals through
        if sys.platform == "win32":
            with _main_hidden():
                return pool.submit(work, task)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPPING)
        try:
            with _main_hidden():
                return pool.submit(work, task)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # A fresh interpreter: threads of this process, and what they hold, are not copied into it.
            context = multiprocessing.get_context("spawn")
            theirs, self._lifeline = context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(self._jobs, context, _begin, (self._share, theirs, self._scratch))
        return self._pool

    def stop(self) -> None:
        """Ends all processes at once; whatever they are about is not finished."""
        if self._lifeline is not None:
            self._lifeline.close()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._pool = self._lifeline = None


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Processes that begin meanwhile do not run the file that Python runs here, which would call what calls this."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def workers(jobs: int, share: Share) -> Iterator[Workers]:
    """So many processes. They end with the block, and what they are about is not finished when it raises."""
    with temporary_folder() as scratch:  # theirs lie in it, and go with it, however they end
        made = Workers(jobs, share, scratch)
        try:
            yield made
        finally:
            made.stop()


def _begin(share: Share, lifeline: Connection, scratch: Path) -> None:
    """What a new process does first."""
    os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
    os.environ["MIPBAKE_THREADS"] = os.environ["OMP_NUM_THREADS"] = str(share.threads)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; who has begun the batch ends it
    signal.signal(signal.SIGTERM, lambda *_: end_at_once())
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPPING)
    threading.Thread(None, _end_with, None, (lifeline,), daemon=True).start()
    keep_freed_memory(share.memory)
    _HELD.enter_context(memory.limited(share.memory))


def end_at_once() -> None:
    """Ends the process at once, without what it had begun to write."""
    for path in unfinished():
        remove(path)
    os._exit(TERMINATED)


def _end_with(lifeline: Connection) -> None:
    """Ends the process when the other end of a pipe is closed: by who has begun the batch, or by its death."""
    try:
        lifeline.recv()
    except (EOFError, OSError):
        end_at_once()


def _failed(task: Task, why: str) -> EntryResult:
    error = WorkerError(
        f"the process that baked it ended before its work{why}: where memory ran out, bake fewer at a time (--jobs), "
        "or hold them to less (--memory)"
    )
    return EntryResult(task.entry, (NotBaked(task.entry.source, error),))
