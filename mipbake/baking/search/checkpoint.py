"""Checkpoints: a folder that a search is kept in, region by region, so that the same search can be resumed later.

`start.npz` holds the stack that the descent begins with, and what the search is. `region-N.npz` holds the texels of a
region that is done. Each file is written once, as a whole (`mipbake.base.checkpoints`). So whenever a process is
killed, what lies there is valid. A region that was at work begins anew.

A process holds a lock on the folder, which the system gives up when the process ends. A second process that wants the
same folder keeps nothing. What cannot be written or read costs time, and nothing else: the search goes on without it.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from mipbake.baking.search.blending import Blend
from mipbake.baking.search.ingredients import Rivals, renders
from mipbake.base import memory
from mipbake.base.checkpoints import DAMAGED, Make, lock_of, read_about, read_arrays, write_kept
from mipbake.base.publish import reason
from mipbake.base.version import __version__
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.terms import TERMS, Weights
from mipbake.quality.reference.problem import Image, Problem

_LOCK, _START, _REGION = "lock", "start.npz", "region-{}.npz"

LEAST_SECONDS = 10.0
"""Between two writings."""

_CHANGED = {"source": "the set changed", "options": "the options changed", "weights": "the weights changed"}

Arrays = Mapping[str, NDArray[Any]]
Windows = Mapping[int, tuple[slice, slice]]
"""The texels of a region: level to rows and columns."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A search as a checkpoint holds it.

    Args:
        arrays, about: of its start; see `start_of`. levels: of the stack, with the regions that are done.
        done: indices of these. seconds: that the search took until the last of them was done.
    """

    arrays: Arrays
    about: Mapping[str, Any]
    levels: list[Image]
    done: frozenset[int]
    seconds: float


class Checkpoint:
    """The folder of one search.

    Args:
        path: of the folder. of: hashes of what the search is: its "source", "options" and "weights".
        timed: whether the search has a limit of time. note: takes sentences about the folder.
    """

    def __init__(self, path: Path, of: Mapping[str, str], timed: bool, note: Callable[[str], None]) -> None:
        self.path = path
        self._of, self._timed, self._note = dict(of), timed, note
        self._lock: int | None = None
        self._useless = False  # nothing can be kept
        self._key: str | None = None  # of the start that lies there, which its regions have, too
        self._done = set[int]()
        self._last = time.monotonic()

    def load(self, begun: Callable[[Kept], Blend]) -> tuple[Kept, Blend] | None:
        """The search as it was kept, and its start; None where there is nothing, or nothing of this search.

        Args:
            begun: makes the start, as `start_of` does, which another checkout of the same version may not have kept.
        """
        try:
            if not self.path.is_dir() or not self._locked():
                return None
            start = read_about(self.path / _START)
            files = [(path, read_about(path)) for path in sorted(self.path.glob(_REGION.format("*")))]
            regions = {path: about for path, about in files if about["key"] == start["key"]}
            why = self._other(start, [start, *regions.values()])
            if not why:
                kept = self._read(start, regions)
                first = begun(kept)
                self._key, self._done = start["key"], set(kept.done)
                return kept, first
        except FileNotFoundError:  # a process was killed before it had written the start
            return None
        except DAMAGED as error:
            why = f"it cannot be read ({error}{' is missing' if isinstance(error, KeyError) else ''})"
        self._note(f"the checkpoint {self.path} is not used, because {why}: the search begins anew")
        return None

    def keep(
        self,
        start: Blend,
        levels: Sequence[Image],
        done: Mapping[int, Windows],
        seconds: float,
        now: bool = False,
    ) -> None:
        """Keeps the start and the regions that are done, unless they were kept a few seconds ago.

        Args:
            levels: of the stack as it is. done: regions by their index. seconds: that the search took so far.
            now: keep them however short that was ago.
        """
        if self._useless or not (now or time.monotonic() - self._last >= LEAST_SECONDS):
            return
        first = self._key is None
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not self._locked():
                return
            self._write(start, levels, done, {"timed": self._timed, "seconds": seconds})
        except OSError as error:
            self._useless = True
            self._note(
                f"the search is not kept in the checkpoint {self.path} ({reason(error)}): it goes on, and cannot be "
                "taken up again later"
            )
            _remove(self.path)
            return
        except BaseException:
            if not (self.path / _START).exists():
                _remove(self.path)
            raise
        self._last = time.monotonic()
        if first:
            self._note(
                f"the search is kept in {self.path} ({memory.told(size_of(self.path))}) from time to time: where it "
                "is interrupted, the same command goes on from there"
            )

    def close(self) -> None:
        """Lets others have the folder."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _other(self, start: Mapping[str, Any], files: Sequence[Mapping[str, Any]]) -> str:
        """Why a checkpoint is not of this search; "" where it is."""
        if start["version"] != __version__:
            return f"it was made by mipbake {start['version']}"
        changed = next((why for part, why in _CHANGED.items() if start["of"][part] != self._of[part]), "")
        if not changed and not self._timed and any(each["timed"] for each in files):
            return "it was made within a limit of time, and without one a search is reproducible"
        return changed

    def _read(self, start: Mapping[str, Any], regions: Mapping[Path, Mapping[str, Any]]) -> Kept:
        arrays = read_arrays(self.path / _START, lambda name: memory.empty if _is_level(name) else None)
        first: list[Image] = [arrays[_level(index)] for index in range(sum(map(_is_level, arrays)))]
        levels = list(first)
        for path, about in regions.items():
            into = {}
            for level, rows, columns in about["windows"]:
                if levels[level] is first[level]:
                    levels[level] = memory.copied(first[level])
                into[_level(level)] = levels[level][slice(*rows), slice(*columns)]
            read_arrays(path, partial(_place_in, into))
        done = frozenset(int(about["index"]) for about in regions.values())
        seconds = max(float(each["seconds"]) for each in (start, *regions.values()))
        return Kept(arrays, start, levels, done, seconds)

    def _write(
        self, start: Blend, levels: Sequence[Image], done: Mapping[int, Windows], about: Mapping[str, Any]
    ) -> None:
        if self._key is None:
            _remove(self.path, folder=False)  # what another search, or a process that was killed, has left
            key, (arrays, names) = uuid.uuid4().hex, _start_parts(start)
            of = {"version": __version__, "of": self._of, "key": key}
            write_kept(self.path / _START, {**about, **of, **names}, arrays)
            self._key = key
        for index in [each for each in done if each not in self._done]:
            windows = [(level, *((s.start, s.stop) for s in at)) for level, at in done[index].items()]
            arrays = {_level(level): levels[level][at] for level, at in done[index].items()}
            own = {"key": self._key, "index": index, "windows": windows}
            write_kept(self.path / _REGION.format(index), {**about, **own}, arrays)
            self._done.add(index)

    def _locked(self) -> bool:
        """Whether this process has the folder; else nothing is kept."""
        if self._lock is None and not self._useless:
            self._lock = lock_of(self.path / _LOCK)
            if self._lock is None:
                self._useless = True
                self._note(f"another process has the checkpoint {self.path}: this search is not kept")
        return not self._useless


def start_of(kept: Kept, problem: Problem, effort: ProbeEffort, judged_by: Weights, seed: int) -> Blend:
    """The start of a search. KeyError where something is missing."""
    arrays, about = kept.arrays, kept.about
    check, held_out = renders(problem, effort, seed)
    baselines = [
        Baseline({name: arrays[f"baseline {index} {name}"] for name in TERMS}, arrays.get(f"plain {index}"))
        for index in range(len(check.lods))
    ]
    return Blend(
        [arrays[_level(index)] for index in range(len(problem.sizes))],
        [tuple(names) for names in about["sources"]],
        Judge(baselines, judged_by),
        check,
        held_out,
        [Rivals(tuple(names), arrays[f"rivals {index}"]) for index, names in enumerate(about["rivals"])],
        [arrays[f"seen {index}"] for index in range(len(check.lods))],
        [arrays[f"plain seen {index}"] for index in range(len(check.lods))],
        arrays["plain held out"],
        arrays["plain decibels"],
        arrays.get("typical"),
    )


def _start_parts(start: Blend) -> tuple[Arrays, Mapping[str, Any]]:
    """All of a start that its problem and its seed do not say: arrays, and what JSON holds."""
    arrays: dict[str, NDArray[Any]] = {_level(index): level for index, level in enumerate(start.levels)}
    arrays |= {f"rivals {index}": rivals.log_errors for index, rivals in enumerate(start.rivals)}
    for index, baseline in enumerate(start.judge.baselines):
        arrays |= {f"baseline {index} {name}": values for name, values in baseline.values.items()}
        if baseline.plain is not None:
            arrays[f"plain {index}"] = baseline.plain
    arrays |= {f"seen {index}": values for index, values in enumerate(start.seen)}
    arrays |= {f"plain seen {index}": values for index, values in enumerate(start.plain)}
    arrays |= {"plain held out": start.plain_held_out, "plain decibels": start.plain_decibels}
    if start.typical is not None:
        arrays["typical"] = start.typical
    names = [rivals.names for rivals in start.rivals]
    return arrays, {"sources": start.sources, "rivals": names}


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


def _level(index: int) -> str:
    """What the array of a level is called."""
    return f"level {index}"


def _is_level(name: str) -> bool:
    return name.startswith("level ")


def _place_in(arrays: Arrays, name: str) -> Make | None:
    """Has an array read into one of these."""
    return (lambda _shape, _dtype: arrays[name]) if name in arrays else None


def _remove(path: Path, folder: bool = True) -> None:
    """Removes what a checkpoint holds, what makes it valid first; and its folder."""
    for file in (path / _START, *(each for each in path.glob("*") if folder or each.name != _LOCK)):
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
    if folder:
        shutil.rmtree(path, ignore_errors=True)
