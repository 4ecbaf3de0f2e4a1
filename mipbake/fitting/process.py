"""A renderer that is a program of the user's own: it is started once, and renders what it is given.

docs/fit-protocol.md is the protocol, for whoever writes such a program.
"""

from __future__ import annotations

import os
import queue
import shlex
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import IO, Any

from mipbake.base.errors import RendererError, UsageError
from mipbake.base.leftovers import begun
from mipbake.base.signals import uninterrupted
from mipbake.fitting.exchange import Exchange, place
from mipbake.fitting.program import Frame
from mipbake.fitting.protocol import JsonView, as_answer, check_answer, request_line, view_as_json
from mipbake.fitting.renderer import Levels
from mipbake.fitting.views import View

TIMEOUT = 120.0
"""Seconds that a program may take to start, and for each frame."""

_KEPT, _SHOWN = 20, 400  # lines of each stream that errors show, and letters of a line
_LONGEST = 1 << 20  # bytes of a line; what is longer is several lines, so that no program fills the memory

# Seconds.
_LOOK = 0.25  # between looks at whether a program still lives
_END = 5.0  # for a program to end after it was asked to, and for the system to end one that was killed
_GRACE = 1.0  # for a program whose output has ended to end too, and for what it printed to arrive


class ProcessRenderer:
    """Renders by a program that speaks the protocol of docs/fit-protocol.md on its standard input and output.

    The program starts with `start`, or with the first render. It is ended by `close`, at the end of a `with` block, or
    when Python ends. After an error it is gone, with all it has started, and the next render starts it anew.

    Args:
        command: the program and its arguments: words, or one text, which is split as a shell does. No shell runs.
        timeout: seconds for its start, and for a frame.

    Raises:
        UsageError: a command without a program, or a time that is not above 0.
    """

    def __init__(self, command: str | Sequence[str], *, timeout: float = TIMEOUT) -> None:
        try:
            # On Windows, backslashes are parts of names.
            windows = sys.platform == "win32"
            words = shlex.split(command, posix=not windows) if isinstance(command, str) else map(os.fspath, command)
            self._command = [word.strip('"') if windows else word for word in words]
        except ValueError as error:
            raise UsageError(
                f"the command of the renderer, {command!r}, cannot be read ({error}): expected a program and its "
                "arguments"
            ) from None
        if not self._command or not self._command[0]:
            raise UsageError(f"the command of the renderer, {command!r}, names no program: expected one")
        if not 0 < timeout < float("inf"):
            raise UsageError(f"a renderer cannot have {timeout} seconds: expected a number above 0")
        self._timeout = timeout
        self._running: tuple[_Program, weakref.finalize[[], ProcessRenderer]] | None = None
        self.called = Path(self._command[0]).name
        """What provenance calls it: the name that the program gave, or the program where it has not started."""

    def start(self) -> _Program:
        """Starts the program, unless it runs. Raises as `render`."""
        if self._running is not None:
            return self._running[0]
        with ExitStack() as held:
            folder = held.enter_context(begun(place(), lambda path: path.mkdir(mode=0o700)))
            with uninterrupted():
                program = _Program(self._command, folder, self._timeout)
                held.callback(program.kill)
            with program.quoted():
                answer = program.ask("hello", {"folder": str(folder)}, "start and say hello")
            self.called = answer["renderer"]
            with uninterrupted():
                self._running = program, weakref.finalize(self, held.pop_all().close)
        return program

    def render(self, levels: Levels, view: View | JsonView) -> Frame:
        """The frame that the program renders: arrays of float32 of its own.

        Args:
            levels: tiles with a stamp that the program has not got are handed to it, and must not change meanwhile.

        Raises:
            RendererError: the program cannot be started, takes too long, ends, breaks the protocol, or reports an
                error. The message has the last lines that it printed.
            OutputError: there is no room for what it is to be handed.
            UsageError: the view cannot be written in JSON, or the program says that what it was given is of no use.
        """
        program = self.start()
        try:
            with program.quoted():
                return program.render(levels, view)
        except BaseException:
            self._kill()
            raise

    def close(self) -> None:
        """Asks the program to end, gives it some seconds, and ends it; removes what was exchanged."""
        if self._running is not None:
            try:
                self._running[0].end()
            finally:
                self._kill()

    def __enter__(self) -> ProcessRenderer:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is None or isinstance(error, Exception):
            self.close()
        else:
            self._kill()

    def _kill(self) -> None:
        running, self._running = self._running, None
        if running is not None:
            running[1]()


class _Program:
    """A program that runs, and the files in a folder that it shares with this process. Threads keep its pipes empty or
    filled, so neither side ever waits for the other. RendererError: it cannot be started."""

    def __init__(self, command: Sequence[str], folder: Path, seconds: float) -> None:
        self._exchange, self._seconds = Exchange(folder), seconds
        self._answers: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._printed: dict[str, deque[bytes]] = {name: deque(maxlen=_KEPT) for name in ("output", "error")}
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
            raise RendererError(
                f"the renderer {command[0]} cannot be started ({getattr(error, 'strerror', None) or error}): expected "
                "a program and its arguments"
            ) from error
        self._threads: dict[IO[bytes], threading.Thread] = {}
        for stream, target in (
            (self._process.stdin, self._feed),
            (self._process.stdout, self._listen),
            (self._process.stderr, partial(_read, take=self._printed["error"].append)),
        ):
            assert stream
            self._threads[stream] = threading.Thread(target=target, args=[stream], daemon=True)
            self._threads[stream].start()

    def render(self, levels: Levels, view: View | JsonView) -> Frame:
        """The frame of a view. Raises as `ProcessRenderer.render`."""
        content = view_as_json(view, self._exchange.mesh)
        request = {"levels": self._exchange.hand(levels), "view": content, "frame": str(self._exchange.frame)}
        return self._exchange.taken(self.ask("render", request, f"render {view.name}"))

    def ask(self, request: str, content: Mapping[str, Any], doing: str) -> dict[str, Any]:
        """Sends a request, and gives the answer. `doing` says in messages what the program was to do."""
        self._lines.put(request_line(request, content))
        end, dead = time.monotonic() + self._seconds, False
        while (rest := end - time.monotonic()) > 0:
            try:
                answer = self._answers.get(timeout=min(rest, _LOOK))  # Python handles signals in between
            except queue.Empty:
                if dead:  # for a while, so nothing of what it said is still on its way
                    raise RendererError(f"{self._death()} and did not {doing}") from None
                dead = self._process.poll() is not None
                continue
            if answer is None:
                raise RendererError(f"{self._death()} and did not {doing}")
            check_answer(answer, "hello" if request == "hello" else "frame")
            return answer
        raise RendererError(
            f"the renderer did not {doing} within {self._seconds:g} seconds, and was stopped: see what it printed, or "
            "give it more time"
        )

    @contextmanager
    def quoted(self) -> Iterator[None]:
        """Ends the program after a RendererError, which then has the last lines of both streams."""
        try:
            yield
        except RendererError as error:
            self.kill()
            parts = []
            for name, lines in self._printed.items():
                shown = [text for line in lines.copy() if (text := _shown(line))]
                if shown:
                    parts.append("\n  ".join([f"last on its standard {name}:", *shown]))
            raise RendererError(f"{error}\n" + ("\n".join(parts) or "it printed nothing")) from error

    def end(self) -> None:
        """Asks the program to end, and closes its standard input."""
        self._lines.put(request_line("end", {}))
        self._lines.put(None)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END)

    def kill(self) -> None:
        """Ends the program and all of its group at once, and lets go of its files. What it has printed is still read.
        Twice is once."""
        with uninterrupted():
            if not self._threads:
                return
            if sys.platform == "win32":
                self._process.kill()
            else:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(self._process.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_END)
            self._lines.put(None)
            threads, self._threads = self._threads, {}
            for stream, thread in threads.items():
                thread.join(_GRACE)
                if not thread.is_alive():  # else a process that left the group still holds the pipe
                    with suppress(OSError):
                        stream.close()
            self._exchange.close()

    def _death(self) -> str:
        try:
            code = self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            return "the renderer closed its standard output, where an answer was expected,"
        if code >= 0:
            return f"the renderer ended with the exit code {code}"
        name = signal.Signals(-code).name if -code in signal.valid_signals() else str(-code)
        return f"the renderer was ended by the signal {name}"

    def _feed(self, stream: IO[bytes]) -> None:
        """Writes lines until there are no more, or nobody reads them."""
        with suppress(OSError):
            while (line := self._lines.get()) is not None:
                rest = memoryview(line)
                while rest:
                    rest = rest[stream.write(rest) :]
        with suppress(OSError):
            stream.close()

    def _listen(self, stream: IO[bytes]) -> None:
        """Takes answers, until there are no more."""

        def take(line: bytes) -> None:
            answer = as_answer(line)
            if answer is None:
                self._printed["output"].append(line)
            else:
                self._answers.put(answer)

        _read(stream, take)
        self._answers.put(None)


def _read(stream: IO[bytes], take: Callable[[bytes], None]) -> None:
    """Takes lines until the stream ends."""
    rest = b""
    with suppress(OSError):
        while chunk := stream.read(1 << 16):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                take(line)
            if len(rest) > _LONGEST:
                take(rest)
                rest = b""
    take(rest)


def _shown(line: bytes) -> str:
    """A printed line as text, without what terminals take for commands."""
    text = line[: 4 * _SHOWN].decode("utf-8", "backslashreplace").replace("\t", "    ").rstrip()
    text = "".join(letter for letter in text if letter.isprintable())
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
