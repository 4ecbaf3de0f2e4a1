"""Work that no signal may stop half-way."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Signals that raise an exception (Ctrl-C, and SIGTERM where a program has a handler) wait until the block ends.

    For steps that take no longer than a file system does. Python handles signals in the main thread alone, so the block
    changes nothing in others.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[signal.Signals] = []
    handlers: dict[signal.Signals, Callable[[int, Any], Any]] = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(number)
            if callable(handler):  # neither ignored, nor what ends a process at once
                handlers[number] = handler
                signal.signal(number, lambda number, _frame: arrived.append(signal.Signals(number)))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in arrived[:1]:
            handlers[number](number, None)
