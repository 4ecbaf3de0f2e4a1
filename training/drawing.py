"""Batches drawn beside the training: in processes of their own where the system can fork them, else in threads.

Drawing and training both are many short calls. Two threads of one interpreter would wait for each other at every one of
them; two processes share nothing but the memory that a batch is handed over in.
"""

from __future__ import annotations

import io
import mmap
import multiprocessing
import pickle
import platform
import signal
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from mipbake import _native
from mipbake.base.errors import MipbakeError

T = TypeVar("T")

_ALIGNMENT = 64  # bytes, a line of the cache: not tuned


class _Pickler(pickle.Pickler):
    """Leaves the numbers of arrays and tensors out, for a buffer of their own."""

    def reducer_override(self, value: Any) -> Any:
        return (torch.from_numpy, (value.numpy(),)) if isinstance(value, Tensor) else NotImplemented


def pack(value: Any) -> tuple[bytes, list[memoryview]]:
    """What `unpack` makes the value of again: a description, and the numbers of the CPU tensors in it."""
    file, buffers = io.BytesIO(), list[pickle.PickleBuffer]()
    _Pickler(file, protocol=5, buffer_callback=buffers.append).dump(value)
    return file.getvalue(), [buffer.raw() for buffer in buffers]


def _places(sizes: list[int]) -> tuple[list[slice], int]:
    """Where buffers of these sizes lie one after the other, and their end."""
    places, end = [], 0
    for size in sizes:
        places.append(slice(end, end + size))
        end += -(-size // _ALIGNMENT) * _ALIGNMENT
    return places, end


class Drawer(Generic[T]):
    """Draws batches ahead, in the order of their requests: `ask` for some indices, then `take` as many.

    Args:
        draw: the batch of an index, a pure function.
        example: an index; batches that are more than twice as large as the batch of this index are handed over slower.
        ahead: batches that are drawn at a time, each by a process or a thread of its own. So many may be requested
            until the first of them is taken.
    """

    def __init__(self, draw: Callable[[int], T], example: int, ahead: int = 1) -> None:
        self.ahead = ahead
        self._threads: ThreadPoolExecutor | None = None
        if platform.system() != "Linux":
            self._threads = ThreadPoolExecutor(ahead, initializer=_one_thread)
            self._draw, self._pending = draw, deque[Future[T]]()
            return
        _, buffers = pack(draw(example))
        room = 2 * _places([len(b) for b in buffers])[1] + mmap.PAGESIZE
        share = max(1, _native.num_threads() // ahead)
        self._idle = deque[_Process](_Process(draw, room, share) for _ in range(ahead))
        self._asked = deque[_Process]()

    def ask(self, index: int) -> None:
        """Has a batch drawn."""
        if self._threads is not None:
            self._pending.append(self._threads.submit(self._draw, index))
            return
        process = self._idle.popleft()
        process.pipe.send(index)
        self._asked.append(process)

    def take(self) -> T:
        """The batch that was requested first; raises what its drawing raised."""
        if self._threads is not None:
            return self._pending.popleft().result()
        process = self._asked.popleft()
        self._idle.append(process)
        try:
            answer, sizes = process.pipe.recv()
        except EOFError as error:
            raise MipbakeError("the process that draws batches has died; continue with --resume") from error
        if isinstance(answer, BaseException):
            raise answer
        places, end = _places(sizes)
        own = memoryview(bytearray(memoryview(process.memory)[:end]))
        batch: T = pickle.loads(answer, buffers=[own[place] for place in places])
        return batch

    def __enter__(self) -> Drawer[T]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
            return
        for process in (*self._idle, *self._asked):
            process.end()


class _Process:
    """A process that draws a batch at a time.

    Args:
        room: bytes for the numbers of a batch. share: threads that kernels may use.
    """

    def __init__(self, draw: Callable[[int], Any], room: int, share: int) -> None:
        self.memory = mmap.mmap(-1, room)  # shared with the fork
        context = multiprocessing.get_context("fork")
        self.pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(draw, theirs, self.pipe, self.memory, share), daemon=True)
        self._process.start()
        theirs.close()

    def end(self) -> None:
        """Ends it, whatever it is about."""
        self.pipe.close()
        self._process.terminate()
        self._process.join()


def _one_thread() -> None:
    """Drawing and training share the cores: a second team of torch threads would only wait for the first."""
    torch.set_num_threads(1)


def _work(draw: Callable[[int], Any], pipe: Connection, theirs: Connection, memory: mmap.mmap, share: int) -> None:
    theirs.close()  # the parent's end, which its death is to close
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's to handle
    _one_thread()
    _native.set_num_threads(share)
    shared = memoryview(memory)
    while True:
        try:
            pipe.send(_answer(draw, pipe.recv(), shared))
        except (EOFError, OSError):
            return  # nobody asks any more


def _answer(draw: Callable[[int], Any], index: int, shared: memoryview) -> tuple[bytes | Exception, list[int]]:
    try:
        batch = draw(index)
        answer, buffers = pack(batch)
        sizes = [len(buffer) for buffer in buffers]
        places, end = _places(sizes)
        if end > len(shared):  # it comes through the pipe, whole
            return pickle.dumps(batch), []
        for place, buffer in zip(places, buffers, strict=True):
            shared[place] = buffer
    except Exception as error:  # whatever it is, the parent raises it
        return error, []
    return answer, sizes
