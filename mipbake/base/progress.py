"""One line that says what is being done, how far it is and how long it takes: for everything that takes long."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from threading import Event, RLock, Thread
from typing import TextIO
from unicodedata import east_asian_width

from mipbake.base.errors import without_middle
from mipbake.base.messages import time_text

EVERY = 10.0
"""Seconds between two lines where no terminal is."""

_IN_TERMINAL = 0.2  # seconds between two looks of the line; nothing is drawn by who does the work
_BAR, _TIMES, _NARROW = 14, 17, 80  # columns of the bar, of times, and of a terminal that does not say how wide it is
_BARRED = 64  # columns from which there is room for a bar beside words
_KNOWN = 3.0  # seconds after which the time that is left is said, and
_LEAST = 0.02  # the least share that it is said from

WORDS: Mapping[str, str] = {
    "read": "looking at the source",
    "prefilter": "making MIP levels",
    "other maps": "averaging other maps",
    "encode": "compressing textures",
    "write": "writing files",
    "check": "checking the files",
    "validate": "measuring",
    "convert": "converting",
    "bake": "baking every method",
    "texture space": "measuring texels",
    "sphere": "rendering spheres",
    "plane": "rendering a plane",
    "film": "filming",
    "temporal slice": "turning the light",
    "apparent BRDF": "plotting reflections",
    "report": "writing the page",
    "first page": "writing a first page",
    "fit": "fitting texels",
}
"""Phase, or what its name begins with before a hyphen, to what is done in it."""


class ProgressLine:
    """The line, which a thread draws again and again; in a terminal in its place, elsewhere a new one now and then.

        with ProgressLine(sys.stderr, "wood", {"read": 1, "write": 3}) as line:
            line.show("read", 0.5)

    Args:
        stream: where it is drawn. label: what the work is about.
        parts: phases in their order, each with its part of all the work; a phase that is not in it adds nothing, and
            without any each phase is all the work.
    """

    def __init__(self, stream: TextIO, label: str = "", parts: Mapping[str, float] | None = None) -> None:
        self._stream, self._label, self._parts = stream, label, parts or {}
        self._terminal = stream.isatty()
        self._phase, self._share, self._note = "", 0.0, ""
        self._end: float | None = None  # when the work is over, where that is known better than by its share
        self._drawn, self._began = 0, time.monotonic()
        self._lock, self._ended = RLock(), Event()
        self._thread = Thread(target=self._draw_often, daemon=True)

    def __enter__(self) -> ProgressLine:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._erase()

    def show(self, phase: str, share: float, left: float | None = None) -> None:
        """Says which phase is at work, and its finished share; `left`: seconds, where these are known better."""
        if not self._phase:
            self._began, self._share = time.monotonic(), 0.0
        if phase != self._phase:
            self._phase, self._note = phase, ""
        if phase in self._parts:
            names = list(self._parts)
            before = sum(self._parts[name] for name in names[: names.index(phase)])
            share = max(self._share, (before + self._parts[phase] * share) / sum(self._parts.values()))
        elif self._parts:
            share = self._share
        self._share = share
        self._end = None if left is None else time.monotonic() + left

    def idle(self) -> None:
        """Nothing is being done: there is no line until something is."""
        with self.aside():
            self._phase = ""

    def note(self, text: str) -> None:
        """Says something beside the phase, such as how good the result is by now."""
        self._note = text

    @contextmanager
    def aside(self) -> Iterator[None]:
        """The line is away while the block prints something that stays."""
        with self._lock:
            self._erase()
            yield

    def text(self, columns: int | None) -> str:
        """The line as it is now, in so many columns at most, with a bar; None for all words and no bar."""
        now = time.monotonic()
        seconds = now - self._began
        left = None if self._end is None else self._end - now
        if left is None and seconds > _KNOWN and self._share >= _LEAST:
            left = seconds * (1 - self._share) / self._share
        percent = f"{self._share:.0%}"
        times = _clock(seconds) + (f", {time_text(round(left))} left" if left and 1 <= left < math.inf else "")
        words = WORDS.get(self._phase) or WORDS.get(self._phase.partition("-")[0], self._phase)
        note = f", {self._note}" if self._note else ""
        if columns is None:
            return f"{self._label}: {words}{note}, {percent}, {times}"
        full = round(_BAR * min(1.0, self._share))
        bar = f" {self._bar(full)}" if columns >= _BARRED else ""
        end = f"{bar} {percent:>4} {times:{_TIMES}}"
        room = max(columns - len(end), 0)
        label = without_middle(self._label, max(room - len(words) - 2 - _wide(self._label), 8))
        room -= _wide(label)
        return (f"{label}: {words}{note}"[:room].ljust(room) + end)[:columns]

    def _bar(self, full: int) -> str:
        try:
            "━╌".encode(self._stream.encoding or "ascii")
        except (LookupError, UnicodeEncodeError):
            return "#" * full + "." * (_BAR - full)
        return "━" * full + "╌" * (_BAR - full)

    def _draw_often(self) -> None:
        while not self._ended.wait(_IN_TERMINAL if self._terminal else EVERY):
            with self._lock:
                if not self._phase:
                    continue
                if not self._terminal:
                    self._write(self.text(None) + "\n")
                    continue
                with suppress(OSError, ValueError):
                    columns = os.get_terminal_size(self._stream.fileno()).columns or _NARROW
                    self._drawn = columns - 1  # a line that fills the last column would begin the next one
                    self._write("\r" + self.text(self._drawn).ljust(self._drawn))

    def _erase(self) -> None:
        if self._drawn:
            self._write("\r" + " " * self._drawn + "\r")
            self._drawn = 0

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # the work is more than the line
            self._stream.write(text)
            self._stream.flush()


def _wide(text: str) -> int:
    """Letters that take two columns of a terminal."""
    return sum(east_asian_width(letter) in "WF" for letter in text)


def _clock(seconds: float) -> str:
    """A time that has passed: `0:41`, `1:02:03`."""
    minutes, whole = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{whole:02}" if hours else f"{minutes}:{whole:02}"
