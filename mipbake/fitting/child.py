"""A program of somebody else's, run as a process: it gets lines, gives answers, prints what it likes, and is ended."""

from __future__ import annotations

import os
import queue
import select
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from mipbake.base.errors import RendererError
from mipbake.base.signals import uninterrupted
from mipbake.fitting.protocol import as_answer

_KEPT = 20
"""Lines of each stream that errors show."""

_SHOWN = 400
"""Letters of a line that errors show."""

_LONGEST = 1 << 20
"""Bytes of a line. What is longer is several lines, so that no program fills the memory."""

_CHUNK = 1 << 16
"""Bytes that a pipe of Linux holds."""

_LOOK = 0.25
"""Seconds between looks at whether a program still lives."""

_GRACE = 1.0
"""Seconds for a program whose output has ended to end too, and for what it printed to arrive."""

_REAP = 5.0
"""Seconds for the system to end a program that was killed, which takes long where a driver is stuck."""


class Child:
    """A program that runs. Three threads keep its pipes empty or filled, so neither side ever waits for the other.

    Args:
        command: the program and its arguments.

    Raises:
        RendererError: it cannot be started.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._said: dict[str, deque[bytes]] = {name: deque(maxlen=_KEPT) for name in ("output", "error")}
        self._give_up = float("inf")
        try:
            # A session of its own makes a group of the program and of what it starts, and keeps Ctrl-C from it.
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            raise RendererError(
                f"the renderer {command[0]} cannot be started ({reason}): expected a program and its arguments"
            ) from error
        assert self._process.stdin and self._process.stdout and self._process.stderr
        self._threads = {
            stream: threading.Thread(None, work, None, arguments, daemon=True)
            for stream, work, *arguments in (
                (self._process.stdin, self._feed, self._process.stdin),
                (self._process.stdout, self._drain, self._process.stdout, self._take, self._ended),
                (self._process.stderr, self._drain, self._process.stderr, self._said["error"].append, lambda: None),
            )
        }
        for thread in self._threads.values():
            thread.start()

    def ask(self, request: bytes, seconds: float, doing: str) -> dict[str, Any]:
        """Sends a line, and gives the next answer.

        Args:
            seconds: how long it may take.
            doing: what the program is to do, for messages, such as "start".

        Raises:
            RendererError: it took longer, or the program has ended.
        """
        self._lines.put(request)
        end, dead = time.monotonic() + seconds, False
        while (rest := end - time.monotonic()) > 0:
            try:
                answer = self._answers.get(timeout=min(rest, _LOOK))
            except queue.Empty:
                if dead:  # for a while, so nothing of what it said is still on its way
                    raise RendererError(self._death(doing)) from None
                dead = self._process.poll() is not None
                continue
            if answer is None:
                raise RendererError(self._death(doing))
            return answer
        raise RendererError(
            f"the renderer did not {doing} within {seconds:g} seconds, and was stopped: see what it printed, or give "
            "it more time"
        )

    def end(self, request: bytes, seconds: float) -> None:
        """Sends a last line, closes the program's standard input, and gives it time to end; then kills what is left."""
        try:
            self._lines.put(request)
            self._lines.put(None)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(seconds)
        finally:
            self.kill()

    def kill(self) -> None:
        """Ends the program and all of its group at once. What it has printed is still read. Twice is once."""
        with uninterrupted():
            if self._give_up < float("inf"):
                return
            self._give_up = time.monotonic() + _GRACE
            if sys.platform == "win32":
                self._process.kill()
            else:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(self._process.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_REAP)
            self._lines.put(None)
            for stream, thread in self._threads.items():
                thread.join(2 * _GRACE)
                if not thread.is_alive():
                    with suppress(OSError):
                        stream.close()

    def printed(self) -> str:
        """The last lines of both streams, for the end of a message; call it after the program was ended."""
        parts = []
        for name, lines in self._said.items():
            shown = [text for line in lines.copy() if (text := _shown(line))]
            if shown:
                parts.append("\n  ".join([f"last on its standard {name}:", *shown]))
        return "\n".join(parts) or "it printed nothing"

    def _death(self, doing: str) -> str:
        try:
            code = self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            return f"the renderer closed its standard output, and did not {doing}: expected an answer there"
        if code < 0:
            with suppress(ValueError):
                return f"the renderer was ended by the signal {signal.Signals(-code).name} and did not {doing}"
            return f"the renderer was ended by the signal {-code} and did not {doing}"
        return f"the renderer ended with the exit code {code} and did not {doing}"

    def _take(self, line: bytes) -> None:
        answer = as_answer(line)
        if answer is None:
            self._said["output"].append(line)
        else:
            self._answers.put(answer)

    def _ended(self) -> None:
        self._answers.put(None)

    def _feed(self, stream: IO[bytes]) -> None:
        """Writes lines until there are no more, or nobody reads them."""
        with suppress(OSError):
            while (line := self._lines.get()) is not None:
                rest = memoryview(line)
                while rest:
                    rest = rest[stream.write(rest) :]
        with suppress(OSError):
            stream.close()

    def _drain(self, stream: IO[bytes], take: Callable[[bytes], None], at_end: Callable[[], None]) -> None:
        """Takes lines until the stream ends, or until nobody will wait any longer for a stream that stays open."""
        rest = b""
        poll = None if sys.platform == "win32" else select.poll()
        if poll is not None:
            poll.register(stream, select.POLLIN)
        while time.monotonic() < self._give_up:
            if poll is not None and not poll.poll(1000 * _LOOK):
                continue
            chunk = stream.read(_CHUNK)
            if not chunk:
                break
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                take(line)
            if len(rest) > _LONGEST:
                take(rest)
                rest = b""
        if rest:
            take(rest)
        at_end()


def _shown(line: bytes) -> str:
    """A printed line as text, without what terminals take for commands."""
    text = line[: 4 * _SHOWN].decode("utf-8", "backslashreplace").replace("\t", "    ").rstrip()
    text = "".join(letter for letter in text if letter.isprintable())
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def command_of(command: str | Sequence[str]) -> list[str]:
    """The words of a command. ValueError where a quotation has no end, or there is no word."""
    import shlex

    if not isinstance(command, str):
        words = [os.fspath(word) if isinstance(word, Path) else str(word) for word in command]
    elif sys.platform == "win32":  # there backslashes are parts of names
        words = [word.strip('"') for word in shlex.split(command, posix=False)]
    else:
        words = shlex.split(command)
    if not words or not words[0]:
        raise ValueError("no program is named")
    return words
