"""Entry point of the console script: what must be settled before the program itself is loaded.

Loading takes about half a second. Until it is over nothing is under way, so a signal ends the process at once, with one
sentence and the same exit code as later. A package of its own, because importing any part of mipbake loads all of it.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False  # the module of that name takes longer to load than all the rest
if TYPE_CHECKING:
    from types import FrameType
    from typing import NoReturn


def run() -> None:
    """Loads and runs the command line."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _leave)
    _fill_descriptors()
    from mipbake.cli.main import run as run_loaded

    run_loaded()


def _leave(number: int, _frame: FrameType | None) -> NoReturn:
    try:
        os.write(2, b"mipbake: stopped while it was loading, nothing was begun\n")
    finally:
        os._exit(128 + number)


def _fill_descriptors() -> None:
    """Opens the null device in the place of a standard stream that was closed: else the first file that is opened gets
    its number, and whatever prints by that number writes into the file."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
