"""What Ctrl-C does while `mipbake bake` optimises texels: the search ends, and the best so far is written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from mipbake.baking.methods import Stop


class Stopping:
    """Hears the first Ctrl-C of a command that comes while a search has something to keep.

    The second one, and any that comes at another time, ends the command as it always does.
    """

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def descending(self) -> Iterator[Stop]:
        """A search has something to keep while the block runs."""
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is not threading.main_thread() or not callable(before):
            yield lambda: self.asked  # nobody can press it here, or it is ignored
            return

        def hear(number: int, frame: FrameType | None) -> None:
            if self.asked:
                before(number, frame)
            self.asked = True

        signal.signal(signal.SIGINT, hear)
        try:
            yield lambda: self.asked
        finally:
            signal.signal(signal.SIGINT, before)
