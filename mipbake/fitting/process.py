"""A renderer that is a program of the user's own: it is started once, and renders what it is asked to.

docs/fit-protocol.md is the protocol, for whoever writes such a program.
"""

from __future__ import annotations

import math
import mmap
import os
import shutil
import sys
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import OutputError, RendererError, UsageError
from mipbake.base.leftovers import begun, tidy
from mipbake.base.publish import reason
from mipbake.base.signals import uninterrupted
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.fitting.child import Child, command_of
from mipbake.fitting.program import ARRAYS, Frame
from mipbake.fitting.protocol import JsonView, check_answer, glb_of, request_line, view_as_json
from mipbake.fitting.renderer import Array, Levels
from mipbake.fitting.views import View

_MEMORY = Path("/dev/shm")
"""Where files of Linux lie in memory."""

_END = 5.0
"""Seconds for a program to end after it was asked to."""

_MESHES = 512
"""Meshes whose files are kept for later views."""

_ROOM = 4 << 30
"""Bytes that must be free there: more than the maps of 8192 texels a side take."""


class ProcessRenderer:
    """Renders by a program that speaks the protocol of docs/fit-protocol.md on its standard input and output.

    The program starts with `start`, or with the first render. It is ended by `close`, at the end of a `with` block, or
    when Python ends. After an error it is gone, with all it has started, and the next render starts it anew.

    Args:
        command: the program and its arguments: words, or one text, which is split as a shell does. No shell runs.
        timeout: seconds for a frame.
        start_timeout: seconds from the start of the program to its first answer.

    Raises:
        UsageError: a command without a program, or a time that is not above 0.
    """

    def __init__(self, command: str | Sequence[str], *, timeout: float = 60.0, start_timeout: float = 120.0) -> None:
        try:
            self._command = command_of(command)
        except ValueError as error:
            raise UsageError(
                f"the command of the renderer, {command!r}, cannot be read ({error}): expected a program and its "
                "arguments"
            ) from None
        for seconds in (timeout, start_timeout):
            if not (math.isfinite(seconds) and seconds > 0):
                raise UsageError(f"a renderer cannot have {seconds} seconds: expected a number above 0")
        self._timeout, self._start_timeout = timeout, start_timeout
        self._running: _Running | None = None
        self.called = Path(self._command[0]).name
        """What provenance calls it: the name that the program gave, or the program where it has not started."""

    def start(self) -> _Running:
        """Starts the program, unless it runs.

        Raises:
            RendererError, UsageError: as `render`.
        """
        if self._running is None:
            with ExitStack() as held:
                folder = held.enter_context(begun(_place(), lambda path: path.mkdir(mode=0o700)))
                exchange = _Exchange(folder)
                held.callback(exchange.close)
                with uninterrupted():
                    child = Child(self._command)
                    held.callback(child.kill)
                try:
                    answer = child.ask(
                        request_line("hello", {"folder": str(folder)}), self._start_timeout, "start and say hello"
                    )
                    check_answer(answer, "hello")
                except RendererError as error:
                    child.kill()
                    raise RendererError(f"{error}\n{child.printed()}") from error
                self.called = answer["renderer"]
                with uninterrupted():
                    kept = held.pop_all()
                    self._running = _Running(child, exchange, weakref.finalize(self, kept.close))
        assert self._running is not None
        return self._running

    def render(self, levels: Levels, view: View | JsonView) -> Frame:
        """The frame that the program renders: arrays of float32 of its own.

        Args:
            levels: tiles with a stamp that the program has not got are handed to it, and must not change meanwhile.

        Raises:
            RendererError: the program cannot be started, takes too long, ends, breaks the protocol, or reports an
                error. The message has the last lines that it printed.
            OutputError: there is no room for what it is to be handed.
            UsageError: the view cannot be told in JSON, or the program says that what it was given is of no use.
        """
        running = self.start()
        try:
            return running.render(levels, view, self._timeout)
        except RendererError as error:
            self._kill()
            raise RendererError(f"{error}\n{running.child.printed()}") from error
        except BaseException:
            self._kill()
            raise

    def close(self) -> None:
        """Asks the program to end, gives it some seconds, and ends it; removes what was exchanged. Twice is once."""
        if self._running is not None:
            try:
                self._running.child.end(request_line("end"), _END)
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

    def _kill(self) -> None:
        running, self._running = self._running, None
        if running is not None:
            running.ended()


class _Running:
    """A program that has said hello, and what it shares with this process.

    Args:
        ended: ends it and removes the folder.
    """

    def __init__(self, child: Child, exchange: _Exchange, ended: weakref.finalize[[], ProcessRenderer]) -> None:
        self.child, self.ended, self._exchange = child, ended, exchange
        self._meshes: dict[Mesh, Path] = {}
        self._count = 0

    def render(self, levels: Levels, view: View | JsonView, seconds: float) -> Frame:
        told = view_as_json(view, self._mesh_file)
        file = self._exchange.folder / "frame.f32"
        content = {"levels": self._exchange.give(levels), "view": told, "frame": str(file)}
        answer = self.child.ask(request_line("render", content), seconds, f"render {view.name}")
        check_answer(answer, "frame")
        return self._exchange.take(answer, file)

    def _mesh_file(self, mesh: Mesh) -> Path:
        """The file of a mesh, which is written where it is not there. Meshes are told apart by identity."""
        if mesh not in self._meshes:
            self._count += 1
            file = self._exchange.folder / f"mesh-{self._count}.glb"
            try:
                if len(self._meshes) >= _MESHES:
                    self._meshes.pop(next(iter(self._meshes))).unlink(missing_ok=True)
                file.write_bytes(glb_of(mesh))
            except OSError as error:
                raise OutputError(f"cannot hand a mesh to the renderer in {file}: {reason(error)}") from error
            self._meshes[mesh] = file
        return self._meshes[mesh]


class _Exchange:
    """The files of one program, in a folder that is there; best in memory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._count = 0
        self._layout: object = None
        self._stamps: tuple[NDArray[np.int64], ...] | None = None
        self._file: Path | None = None
        self._map: mmap.mmap | None = None

    def give(self, levels: Levels) -> dict[str, Any]:
        """Writes the texels that the program has not got, and returns what it is told of all of them.

        Raises:
            OutputError: there is no room.
        """
        widths = {name: each[0].shape[2] for name, each in levels.maps.items()}
        layout = levels.model, tuple(levels.wrap), widths, levels.sizes
        if layout != self._layout:
            self.close()
            self._layout, self._stamps, self._count = None, None, self._count + 1
            self._file = self.folder / f"maps-{self._count}.f32"
            self._map = _mapped(self._file, sum(4 * level.size for each in levels.maps.values() for level in each))
            self._layout = layout
        changed, self._stamps = levels.changed(self._stamps), levels.stamps
        assert self._map is not None
        at = 0
        for index, parts in enumerate(changed):
            for maps in levels.maps.values():
                values = maps[index]
                out = np.frombuffer(self._map, "<f4", values.size, at).reshape(values.shape)
                for part in parts:
                    np.copyto(part.of(out), part.of(values), casting="same_kind")
                del out  # else the file could not be let go of
                at += 4 * values.size
        stack = [
            {"size": list(size), "changed": [list(part) for part in parts]}
            for size, parts in zip(levels.sizes, changed, strict=True)
        ]
        about = {"model": levels.model, "wrap": list(levels.wrap), "maps": widths, "stack": stack}
        return {**about, "file": str(self._file)}

    def take(self, answer: Mapping[str, Any], file: Path) -> Frame:
        """The frame that an answer tells of; its file is removed.

        Raises:
            RendererError: there is none, or it is cut short. What else it lacks is for others to say.
        """
        shapes = answer.get("arrays")
        if not isinstance(shapes, dict) or "image" not in shapes:
            raise RendererError('the frame of the renderer shows nothing: expected an object "arrays" with an image')
        try:
            numbers = np.fromfile(file, "<f4").astype(np.float32, copy=False)
        except OSError as error:
            raise RendererError(
                f"the frame of the renderer cannot be read ({error.strerror or error}): expected the file {file}, "
                "complete before the answer"
            ) from error
        finally:
            with suppress(OSError):
                file.unlink()
        found: dict[str, Array] = {}
        at = 0
        for name, shape in shapes.items():
            if not isinstance(shape, list) or not all(type(each) is int and each >= 0 for each in shape):
                raise RendererError(
                    f"the renderer gave {name} of its frame the shape {shape!r}: expected whole numbers"
                )
            count = math.prod(shape)
            if at + count > numbers.size:
                raise RendererError(
                    f"the frame that the renderer wrote is cut short: expected {4 * count} bytes of {name} from byte "
                    f"{4 * at} on, found {4 * numbers.size} bytes"
                )
            if name in ARRAYS:
                found[name] = numbers[at : at + count].reshape(shape)
            at += count
        return Frame(found["image"], *(found.get(name) for name in ARRAYS[1:]))

    def close(self) -> None:
        """Lets go of the file of the maps. Twice is once."""
        if self._map is not None:
            with suppress(BufferError):  # an error still holds what it was about to write; it goes with that
                self._map.close()
            self._map = None
        if self._file is not None:
            with suppress(OSError):  # a program may still hold it, where systems mind that
                self._file.unlink()
            self._file = None


def _mapped(file: Path, size: int) -> mmap.mmap:
    """A new file of zeros, mapped into memory, which takes its room on the disk at once: a page that finds none later
    would end the process."""
    try:
        with file.open("w+b") as opened:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(opened.fileno(), 0, size)
            else:
                opened.write(bytes(size))
                opened.flush()
            return mmap.mmap(opened.fileno(), size)
    except OSError as error:
        raise OutputError(f"cannot hand levels to the renderer in {file}: {reason(error)}") from error


def _place() -> Path:
    """Beside which path a folder for the exchange is made: in memory where there is room, or among temporary files.

    What killed processes left there is removed.
    """
    place = Path(tempfile.gettempdir())
    if sys.platform == "linux":
        try:
            if shutil.disk_usage(_MEMORY).free >= _ROOM:
                with tempfile.TemporaryFile(dir=_MEMORY):  # there may be room, and no permission
                    place = _MEMORY
        except OSError:
            pass
    tidy(place / "mipbake-fit")
    return place / "mipbake-fit"
