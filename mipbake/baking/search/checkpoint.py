"""Checkpoints: a folder in which a search is kept from time to time, so that a later sitting goes on from there.

`about.json` says what the search is and which files are part of it. It is replaced after these files are on the disk
(`mipbake.base.checkpoints`). So whenever a process is killed, a whole checkpoint lies there, or none. The start is
written once, each region that is done once, and the region at work every time.

A process holds a lock on the folder, which the system gives up when the process ends. A second process that wants the
same folder keeps nothing. What cannot be written or read costs time, and nothing else: the search goes on without it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.search.kept_search import Come, Parts, name_of, state_of, state_parts
from mipbake.base import memory
from mipbake.base.checkpoints import DAMAGED, Make, lock_of, read_arrays, write_arrays
from mipbake.base.publish import reason, replacing
from mipbake.base.version import __version__
from mipbake.quality.reference.problem import Image

_ABOUT, _LOCK, _START = "about.json", "lock", "start.npz"
_FORMAT = 1  # of the files; not tuned
LEAST_SECONDS = 10.0
"""Between two writings."""

COST = 0.02
"""Share of the time that writing may take."""

_RATE = 2e8  # bytes that a disk writes in a second, before it is measured
_WORDS = {"source": "the set changed", "options": "the options changed", "weights": "the weights changed"}

Windows = Callable[[int], Mapping[int, tuple[slice, slice]]]
"""Index of a region to what it moves: level to its rows and columns."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A search as a checkpoint holds it.

    Args:
        start: see `kept_search.start_parts`. levels: what became of the start's; the same arrays where nothing changed.
        come: how far its descent has come. seconds: how long all sittings took.
    """

    start: Parts
    levels: list[Image]
    come: Come
    seconds: float


class Checkpoint:
    """The folder of one search.

    Args:
        path: of the folder. of: hashes of what the search is: its "source", "options" and "weights".
        timed: whether the search has a limit of time. told: hears sentences about the folder.
    """

    def __init__(self, path: Path, of: Mapping[str, str], timed: bool, told: Callable[[str], None]) -> None:
        self.path = path
        self._of, self._timed, self._told = dict(of), timed, told
        self._lock: int | None = None
        self._useless = False  # nothing can be kept
        self._spoken = False
        self._regions: dict[int, str] = {}
        self._start: dict[str, Any] | None = None  # what JSON holds of the start that is kept
        self._state: str | None = None
        self._writings = 0
        self._last, self._rate = time.monotonic(), _RATE

    @property
    def holds(self) -> bool:
        """Whether something is kept of this search."""
        return self._start is not None and not self._useless

    def load(self, shapes: Sequence[tuple[int, ...]], windows: Windows) -> Kept | None:
        """The search as it was kept; None where there is nothing, or nothing of this search.

        Args:
            shapes: of the levels.
        """
        try:
            if not self.path.is_dir() or not self._locked():
                return None
            about = read_about(self.path / _ABOUT)
            why = self._other(about)
            kept = None if why else self._read(about, shapes, windows)
        except FileNotFoundError:  # a process was killed before it had written all of the first one
            why, kept = "", None
        except DAMAGED as error:
            why, kept = f"it cannot be read ({error})", None
        if why:
            self._told(f"the checkpoint {self.path} is not used, because {why}: the search begins anew")
        return kept

    def due(self) -> bool:
        """Whether so long has passed that it may be worth to keep something."""
        return not self._useless and time.monotonic() - self._last >= LEAST_SECONDS

    def keep(
        self,
        start: Callable[[], Parts],
        levels: Sequence[Image],
        windows: Windows,
        come: Come,
        seconds: float,
        now: bool = False,
    ) -> None:
        """Keeps a search, unless it was not long since the last time beside how long it takes.

        Args:
            start: makes its start. levels, come, seconds: as `Kept` has them. now: keep it whatever it takes.
        """
        if self._useless:
            return
        state = None if come.state is None else state_parts(come.state)
        begun = None if self._start is not None else start()
        new = [index for index in come.done if index not in self._regions]
        moved = {index: {level: levels[level][at] for level, at in windows(index).items()} for index in new}
        size = sum(each.bytes for each in (state, begun) if each is not None)
        size += sum(each.nbytes for some in moved.values() for each in some.values())
        if not now and time.monotonic() - self._last < size / self._rate / COST:
            return
        begin = time.monotonic()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not self._locked():
                return
            self._write(begun, moved, state, come, seconds)
        except OSError as error:
            self._useless = True
            self._told(
                f"the search is not kept in the checkpoint {self.path} ({reason(error)}): it goes on, and cannot be "
                "taken up again later"
            )
            self._empty()
            return
        except BaseException:
            if not (self.path / _ABOUT).exists():
                self._empty()
            raise
        self._last = time.monotonic()
        self._rate = size / max(1e-3, self._last - begin)
        if not self._spoken:
            self._spoken = True
            size = sum(file.stat().st_size for file in self.path.iterdir())
            self._told(
                f"the search is kept in {self.path} ({memory.told(size)}) from time to time: where it is interrupted, "
                "the same command goes on from there"
            )

    def close(self) -> None:
        """Lets others have the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _other(self, about: Mapping[str, Any]) -> str:
        """Why a checkpoint is not of this search; "" where it is."""
        if about["format"] != _FORMAT or about["version"] != __version__:
            return f"it was made by mipbake {about['version']}"
        changed = next((why for part, why in _WORDS.items() if about["of"][part] != self._of[part]), "")
        if not changed and about["timed"] and not self._timed:
            return "it was made within a limit of time, and without one a search is reproducible"
        return changed

    def _read(self, about: Mapping[str, Any], shapes: Sequence[tuple[int, ...]], windows: Windows) -> Kept:
        named = {name_of(index): shape for index, shape in enumerate(shapes)}

        def whole(name: str) -> Make | None:
            return _expecting(named[name], memory.empty) if name in named else None

        begun = Parts(read_arrays(self.path / _START, whole), about["start"])
        first = [begun.arrays[name] for name in named]
        levels = list(first)
        for index, file in about["regions"].items():
            parts = {name_of(level): (level, at) for level, at in windows(int(index)).items()}
            for level, _ in parts.values():
                if levels[level] is first[level]:
                    levels[level] = memory.copied(first[level])

            def part(name: str, parts: Mapping[str, Any] = parts) -> Make:
                level, at = parts[name]
                into = levels[level][at]
                return _expecting(into.shape, lambda _shape, _dtype: into)

            read_arrays(self.path / file, part)
        state = None
        if about["state"] is not None:
            state = state_of(Parts(read_arrays(self.path / about["state"], lambda _: None), about["at work"]))
            inside = {level: first[level][at].shape for level, at in windows(about["at"]).items()}
            if any(texels.inside.shape != inside.get(level) for level, texels in state.texels.items()):
                raise ValueError("its region has another size")
        self._regions = {int(index): file for index, file in about["regions"].items()}
        self._start, self._state, self._writings = about["start"], about["state"], about["writings"]
        self._timed = self._timed or about["timed"]
        self._spoken = True  # who made it was told of it
        come = Come(tuple(self._regions), int(about["at"]), state)
        return Kept(begun, levels, come, float(about["seconds"]))

    def _write(
        self,
        begun: Parts | None,
        moved: Mapping[int, Mapping[int, Image]],
        state: Parts | None,
        come: Come,
        seconds: float,
    ) -> None:
        if begun is not None:
            self._empty(folder=False)  # what another search, or a process that was killed, has left
            write_arrays(self.path / _START, begun.arrays)
        made = {}
        for index, some in moved.items():
            made[index] = f"region-{index}.npz"
            write_arrays(self.path / made[index], {name_of(level): each for level, each in some.items()})
        file = f"state-{self._writings}.npz" if state is not None else None
        if state is not None and file is not None:
            write_arrays(self.path / file, state.arrays)
        regions = {**self._regions, **made}
        start = dict(begun.about) if begun is not None else self._start
        about = {
            "format": _FORMAT,
            "version": __version__,
            "of": self._of,
            "timed": self._timed,
            "seconds": seconds,
            "writings": self._writings + 1,
            "start": start,
            "regions": {str(index): name for index, name in regions.items()},  # as JSON has them: it sorts text as text
            "at": come.at,
            "state": file,
            "at work": None if state is None else state.about,
        }
        with replacing(self.path / _ABOUT) as partial:
            partial.write_text(json.dumps({"sum": checksum(about), "about": about}), encoding="utf-8")
        old, self._state, self._regions, self._start = self._state, file, regions, start
        self._writings += 1
        if old is not None:
            (self.path / old).unlink(missing_ok=True)

    def _locked(self) -> bool:
        """Whether this process has the folder; else nothing is kept."""
        if self._lock is None and not self._useless:
            self._lock = lock_of(self.path / _LOCK)
            if self._lock is None:
                self._useless = True
                self._told(f"another process has the checkpoint {self.path}: this search is not kept")
        return not self._useless

    def _empty(self, folder: bool = True) -> None:
        _remove(self.path, folder)
        self._regions, self._start, self._state = {}, None, None


def read_about(path: Path) -> dict[str, Any]:
    found = json.loads(path.read_bytes())
    about: dict[str, Any] = found["about"]
    if found["sum"] != checksum(about):
        raise ValueError("its description is damaged")
    return about


def checksum(about: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()


def discard(path: Path) -> None:
    """Removes a checkpoint, where there is one that no process works with."""
    if not path.is_dir():
        return
    lock = lock_of(path / _LOCK)
    if lock is not None:
        try:
            _remove(path)
        finally:
            os.close(lock)


def size_of(path: Path) -> int:
    """Bytes of a checkpoint; 0 where there is none."""
    try:
        return sum(file.stat().st_size for file in path.iterdir())
    except OSError:
        return 0


def _remove(path: Path, folder: bool = True) -> None:
    """Removes what a checkpoint holds, what makes it valid first; and its folder."""
    for file in (path / _ABOUT, *(each for each in path.glob("*") if folder or each.name != _LOCK)):
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
    if folder:
        shutil.rmtree(path, ignore_errors=True)


def _expecting(shape: tuple[int, ...], make: Make) -> Make:
    def made(found: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        if found != shape or dtype != np.float32:
            raise ValueError(f"it has an array of {found}, and not of {shape}")
        return make(found, dtype)

    return made
