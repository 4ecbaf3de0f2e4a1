"""A server of `mipbake gui` within a test."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from mipbake.cli.gui_bakes import Bench
from mipbake.cli.gui_server import Server


class _EndError(Exception):
    pass


@contextmanager
def serving(bench: Bench) -> Iterator[Server]:
    """Serves with a thread in place of the main one, which ends with the block."""
    server = Server(bench)

    def end() -> None:
        raise _EndError

    def run() -> None:
        with pytest.raises(_EndError):
            server.run()

    worker = threading.Thread(target=run)
    worker.start()
    try:
        yield server
    finally:
        server.work.put(end)
        worker.join(60)
    assert not worker.is_alive()
