"""Standard streams that a run does not fail on: what they do not take is lost, and the first reason is remembered; and
whether there is a screen beside them."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TextIO


class _Patient(io.FileIO):
    """A stream that accepts every byte, whether it can be written or not."""

    lost: OSError | None = None
    was_closed = False

    def write(self, data: object) -> int:
        """Writes, and returns how many bytes the caller need not write again."""
        try:
            if self.was_closed:
                raise OSError(errno.EBADF, "it is closed")
            return super().write(data)  # type: ignore[arg-type]
        except OSError as error:
            self.lost = self.lost or error
            return memoryview(data).nbytes  # type: ignore[arg-type]


def replace_streams() -> None:
    """Replaces stdout and stderr, which may be closed, full, or without a reader while a bake goes on."""
    sys.stdout = _patient(sys.stdout)
    sys.stderr = _patient(sys.stderr)


def lost(stream: TextIO) -> OSError | None:
    """Why some of what was written to a stream is lost. None where nothing is, or where its reader wanted no more."""
    stream.flush()
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    error = raw.lost if isinstance(raw, _Patient) else None
    return None if error is None or error.errno == errno.EPIPE else error


def has_screen() -> bool:
    """Whether a browser would open in a window, and not in this terminal."""
    return sys.platform in ("win32", "darwin") or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")))


def _patient(stream: TextIO | None) -> TextIO:
    """A stream to the same place. Names that the encoding lacks are escaped in it, and do not end the run either."""
    if stream is None:  # what Python gives for a closed stream
        raw = _Patient(os.devnull, "w")
        raw.was_closed = True
        return io.TextIOWrapper(io.BufferedWriter(raw), encoding="utf-8", errors="backslashreplace")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    stream.reconfigure(errors="backslashreplace")
    if type(getattr(stream.buffer, "raw", stream.buffer)) is not io.FileIO:  # a console of Windows
        return stream
    raw = _Patient(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=stream.line_buffering or stream.write_through,  # what is unbuffered is here soon, too
        write_through=stream.write_through,
    )
