"""A renderer that is a program of the user's own: it is started once, and renders what it is asked to.

docs/fit-protocol.md is the protocol, for whoever writes such a program.
"""

from __future__ import annotations

import math
import shutil
import sys
import tempfile
import weakref
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from mipbake.base.errors import OutputError, RendererError, UsageError
from mipbake.base.leftovers import begun, tidy
from mipbake.base.publish import reason
from mipbake.base.signals import uninterrupted
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.child import Child, command_of
from mipbake.fitting.exchange import EXCHANGES, Exchange, bytes_of
from mipbake.fitting.protocol import check_answer, glb_of, name_of, request_line, view_as_json
from mipbake.fitting.renderer import Frame, Levels
from mipbake.fitting.views import View

_MEMORY = Path("/dev/shm")
"""Where files of Linux lie in memory."""

_END = 5.0
"""Seconds for a program to end after it was asked to."""

_MESHES = 512
"""Meshes whose files are kept for later views."""

_PIXEL = 4 * 11
"""Bytes that a pixel of a frame takes, at most: 11 numbers."""

_PIXELS = 1920 * 1080
"""Pixels of a frame whose size only the program knows."""


class ProcessRenderer:
    """Renders by a program that speaks the protocol of docs/fit-protocol.md on its standard input and output.

    The program starts with the first render. It is ended by `close`, at the end of a `with` block, or when Python ends.
    After an error it is gone, with all it has started, and the next render starts it anew.

    Args:
        command: the program and its arguments: words, or one text, which is split as a shell does. No shell runs.
        exchange: "memory": numbers of 32 bits in files that both sides map into memory; or "exr": EXR files.
        timeout: seconds for a frame.
        start_timeout: seconds from the start of the program to its first answer.

    Raises:
        UsageError: a command without a program, an exchange of another name, or a time that is not above 0.
    """

    def __init__(
        self,
        command: str | Sequence[str],
        *,
        exchange: str = "memory",
        timeout: float = 60.0,
        start_timeout: float = 120.0,
    ) -> None:
        try:
            self._command = command_of(command)
        except ValueError as error:
            raise UsageError(
                f"the command of the renderer, {command!r}, cannot be read ({error}): expected a program and its "
                "arguments"
            ) from None
        if exchange not in EXCHANGES:
            raise UsageError(f"no exchange is called {exchange!r}: expected {' or '.join(EXCHANGES)}")
        for seconds in (timeout, start_timeout):
            if not (math.isfinite(seconds) and seconds > 0):
                raise UsageError(f"a renderer cannot have {seconds} seconds: expected a number above 0")
        self._exchange, self._timeout, self._start_timeout = exchange, timeout, start_timeout
        self._running: _Running | None = None
        self._number = 0
        self.called = Path(self._command[0]).name
        """What provenance calls it: the name that the program gave, or the program where it has not started."""

    def render(self, levels: Levels, view: Any) -> Frame:
        """The frame that the program renders.

        Args:
            levels: tiles with a stamp that the program has not got are handed to it, and must not change meanwhile.
            view: a `View`, a `JsonView`, or a mapping of what JSON knows, which is handed through.

        Returns:
            Arrays of float32 of its own, and `id` as int32.

        Raises:
            RendererError: the program cannot be started, takes too long, ends, breaks the protocol, or reports an
                error. The message has the last lines that it printed.
            OutputError: there is no room for what it is to be handed.
            UsageError: the view cannot be told in JSON.
        """
        running = self._running = self._running or self._start(levels, view)
        self._number += 1
        try:
            return running.render(levels, view, self._number, self._timeout)
        except RendererError as error:
            self._kill()
            raise RendererError(f"{error}\n{running.child.printed()}") from error
        except BaseException:
            self._kill()
            raise

    def close(self) -> None:
        """Asks the program to end, gives it some seconds, and ends it; removes what was exchanged. Twice is once."""
        running = self._running
        if running is not None:
            try:
                running.child.end(request_line("end"), _END)
            finally:
                self._kill()

    def __enter__(self) -> ProcessRenderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or issubclass(kind, Exception):
            self.close()
        else:
            self._kill()

    def _start(self, levels: Levels, view: Any) -> _Running:
        """Starts the program; nothing is left where that fails."""
        with ExitStack() as held:
            folder = held.enter_context(begun(_place(levels, view), lambda path: path.mkdir(mode=0o700)))
            exchange = EXCHANGES[self._exchange](folder)
            held.callback(exchange.close)
            with uninterrupted():
                child = Child(self._command)
                held.callback(child.kill)
            hello = request_line("hello", {"exchange": self._exchange, "folder": str(folder)})
            try:
                answer = child.ask(hello, self._start_timeout, "start and say hello")
                check_answer(answer, "hello")
            except RendererError as error:
                child.kill()
                raise RendererError(f"{error}\n{child.printed()}") from error
            self.called = answer["renderer"]
            with uninterrupted():
                kept = held.pop_all()
                return _Running(child, exchange, folder, weakref.finalize(self, kept.close))
        raise AssertionError("unreachable")  # for mypy, which takes an ExitStack for something that hides errors

    def _kill(self) -> None:
        running, self._running = self._running, None
        if running is not None:
            running.held()


class _Running:
    """A program that has said hello, and what it shares with this process.

    Args:
        held: ends the program and removes the folder.
    """

    def __init__(
        self, child: Child, exchange: Exchange, folder: Path, held: weakref.finalize[[], ProcessRenderer]
    ) -> None:
        self.child, self.held = child, held
        self._exchange, self._folder = exchange, folder
        self._meshes: dict[Mesh, Path] = {}
        self._written = 0

    def render(self, levels: Levels, view: Any, number: int, seconds: float) -> Frame:
        told = view_as_json(view, self._mesh_file)
        file = self._exchange.frame_file(number)
        content = {"id": number, "levels": self._exchange.give(levels), "view": told, "frame": str(file)}
        answer = self.child.ask(request_line("render", content), seconds, f"render {name_of(view)}")
        check_answer(answer, "frame", number)
        return self._exchange.take(answer, file)

    def _mesh_file(self, mesh: Mesh) -> Path:
        """The file of a mesh, which is written where it is not there. Meshes are told apart by identity."""
        if mesh not in self._meshes:
            self._written += 1
            file = self._folder / f"mesh-{self._written}.glb"
            try:
                if len(self._meshes) >= _MESHES:
                    self._meshes.pop(next(iter(self._meshes))).unlink(missing_ok=True)
                file.write_bytes(glb_of(mesh))
            except OSError as error:
                raise OutputError(f"cannot hand a mesh to the renderer in {file}: {reason(error)}") from error
            self._meshes[mesh] = file
        return self._meshes[mesh]


def _place(levels: Levels, view: Any) -> Path:
    """Beside which path a folder for the exchange is made: in memory where there is room, or among temporary files.

    What killed processes left there is removed.
    """
    frame = _PIXEL * (math.prod(view.size) if isinstance(view, View) else _PIXELS)
    place = Path(tempfile.gettempdir())
    if sys.platform == "linux":
        try:
            if shutil.disk_usage(_MEMORY).free >= 2 * (bytes_of(levels) + frame):
                with tempfile.TemporaryFile(dir=_MEMORY):  # there may be room, and no permission
                    place = _MEMORY
        except OSError:
            pass
    tidy(place / "mipbake-fit")
    return place / "mipbake-fit"
