"""What is known of the sets of a library from the last time, so that what has not changed need not be read.

It lies in a file beside the results, to which a line of JSON is added for each set that was baked or found unchanged.
The last line of a set counts. The file is a shortcut alone. Whether a result is what it would be baked to again stands
in the result itself (`mipbake.baking.recipe`). Without the file, or where a line is damaged, sources are read and
compared, and nothing is baked that need not be.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from mipbake.base import disk, json_text
from mipbake.base.errors import InputError, OutputError
from mipbake.base.publish import TRIAL, is_companion, replaced_file
from mipbake.library.listing import Entry
from mipbake.source.archives import MATERIALX
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.layout import is_manifest
from mipbake.source.matches import is_textures
from mipbake.source.tiles import is_pattern
from mipbake.stack.output import GLB

FOLDER, LIST = ".mipbake", "batch.jsonl"

FRESH = 2_000_000_000
"""Nanoseconds: file systems tell times as coarsely as two seconds, so a younger file may change and keep its time."""


class FileState(NamedTuple):
    """A file, without a look at what is in it.

    Args:
        path: relative to the folder that the record is about.
        size: in bytes; -1 for a file that is not there.
        modified: in nanoseconds; -1 where the file was so young that its time does not tell whether it changed.
        changed: when its name, its times or its content were changed last, in nanoseconds; 0 for results, which may be
            copied.
    """

    path: str
    size: int
    modified: int
    changed: int = 0


@dataclass(frozen=True)
class Record:
    """What is known of an entry.

    Args:
        entry: its label. source: its absolute path.
        recipe: a hash of how it was read and baked.
        files: that it was baked from, relative to the folder around the source.
        results: files of its results, relative to the folder of all results.
        count: how many results there are.
        faults: what is wrong with files of it, each a sentence with the exit code of its error.
    """

    entry: str
    source: str
    recipe: str
    files: tuple[FileState, ...]
    results: tuple[FileState, ...]
    count: int
    faults: tuple[tuple[str, int], ...] = ()

    def is_of(self, entry: Entry) -> bool:
        """Whether it is about the source of an entry, and not about another one that has the same label."""
        return self.source == absolute(entry.source)

    def is_without_source(self) -> bool:
        """Whether all files that it was baked from are gone."""
        around = Path(self.source).parent
        return bool(self.files) and not any(os.path.lexists(around / file.path) for file in self.files)


def state_of(path: Path, folder: Path, ours: bool = False) -> FileState:
    """The state of a file; its path is relative to a folder. `ours`: nobody changes it who has written it."""
    name = os.path.relpath(path, folder)
    try:
        found = path.stat()
    except OSError:
        return FileState(name, -1, -1)
    fresh = not ours and 0 <= time.time_ns() - found.st_mtime_ns < FRESH
    return FileState(name, found.st_size, -1 if fresh else found.st_mtime_ns, 0 if ours else found.st_ctime_ns)


def states(entry: Entry, others: Iterable[Path] = ()) -> tuple[FileState, ...]:
    """The states of all files that decide what an entry is baked to: all files of a folder, because names decide which
    of them are maps; the files of one of the sets in it; or the source, and what it refers to.

    Args:
        others: files that it refers to.
    """
    paths = dict.fromkeys([*_own_files(entry), *others])
    return tuple(state_of(path, entry.source.parent) for path in paths)


def _own_files(entry: Entry) -> Iterator[Path]:
    source = entry.source
    if entry.part:
        yield from entry.files
        return
    folder = source if source.is_dir() else source.parent if is_pattern(source) else None
    if folder is None:
        yield source
        if source.suffix.lower() == MATERIALX:  # which may include others
            yield from (file for file in sorted(source.parent.rglob(f"*{MATERIALX}")) if file != source)
        return
    with suppress(InputError):  # its turn will say so
        for each in (folder, *filter(is_textures, disk.folders_in(folder))):
            # Other files decide nothing: somebody's notes, or what the command itself prints.
            yield from (file for file in disk.files_in(each) if file.suffix.lower() in (*IMAGE_SUFFIXES, ".json"))


def sources_are_same(record: Record, entry: Entry) -> bool:
    """Whether no file that an entry was baked from has changed since, as far as sizes and times tell.

    Args:
        record: of the last time. entry: as it is now. Which files a MaterialX document is about is not known without a
            look into it, because it may include others, and stand for tiles that are new.
    """
    source = entry.source
    if source.suffix.lower() == MATERIALX:
        return False
    before = {file.path for file in record.files}
    own = {os.path.relpath(path, source.parent) for path in _own_files(entry)}
    return own <= before and all(_same(file, source.parent) for file in record.files)


def results_are_same(record: Record, out: Path) -> bool:
    """Whether the results in a folder are the files that were written last."""
    return all(_same(file, out, ours=True) for file in record.results)


def places_of(record: Record, out: Path) -> set[Path]:
    """Folders and files beside which unfinished work on the results of an entry lies, without links: the results
    themselves, and what folders are made on trial as. `out`: the folder of all results."""
    files = [PurePath(each.path) for each in record.results]
    named = {file if file.suffix == f".{GLB}" else file.parent for file in files}
    places = {Path(os.path.realpath(out / each)) for each in named}
    return places | {place.with_name(TRIAL) for place in places}


def _same(file: FileState, folder: Path, ours: bool = False) -> bool:
    now = state_of(folder / file.path, folder, ours)
    return now.size == -1 if file.size == -1 else file.modified != -1 and now == file


def remains(record: Record, out: Path) -> list[Path]:
    """What is left of results whose `stack.json` is gone: build systems remove the file that they know, and a folder
    without it is nobody's. Only files that nobody changed since they were written, in folders that hold nothing else.

    Args:
        out: the folder of all results.
    """
    folders: dict[Path, list[FileState]] = {}
    for each in record.results:
        folders.setdefault((out / each.path).parent, []).append(each)
    found: list[Path] = []
    for folder, files in folders.items():
        declaring = [out / each.path for each in files if is_manifest(PurePath(each.path).name)]
        if not declaring or all(file.exists() for file in declaring):
            continue
        ours = {out / each.path for each in files if _same(each, out, ours=True)}
        with suppress(OSError):  # the whole folder may be gone
            inside = [each for each in folder.iterdir() if not is_companion(each)]
            found += inside if ours.issuperset(inside) else []
    return found


def recipe_of(*parts: Any) -> str:
    """One hash of everything that says how an entry is read and baked."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def absolute(path: Path) -> str:
    """The same path from everywhere. Links stay."""
    return os.path.abspath(path)  # noqa: PTH100  resolve follows links


class States:
    """The file, and the last record of each entry.

    Nothing ends where it cannot be read or written: then nothing is known, or nothing is kept for the next time. Other
    processes may add to it at the same time.

    Args:
        out: the folder of all results.
        write: whether it is written; else what is remembered is forgotten.
    """

    def __init__(self, out: Path, write: bool = True) -> None:
        self._place = out / FOLDER / LIST
        self._write = write
        self.records: dict[str, Record] = {}
        lines: list[bytes] = []
        with suppress(OSError):
            lines = self._place.read_bytes().split(b"\n")
        for record in filter(None, map(_parsed, lines)):
            self.records[record.entry] = record
        if write and len(lines) > 2 * len(self.records) + 2:  # most of it is out of date
            with suppress(OutputError):
                replaced_file(self._place, b"".join(map(_line, self.records.values())))

    def remember(self, record: Record) -> None:
        """Keeps what is known of an entry."""
        self.records[record.entry] = record
        if self._write:
            with suppress(OSError):
                self._place.parent.mkdir(parents=True, exist_ok=True)
                with self._place.open("ab", buffering=0) as file:  # one call of the system writes the whole line
                    file.write(_line(record))


def _line(record: Record) -> bytes:
    """A line for a record. It begins with the end of the line before it, which may have been cut off."""
    return b"\n" + json.dumps(asdict(record)).encode()


def _parsed(line: bytes) -> Record | None:
    """The record of a line; None where it holds none."""
    try:
        found = json_text.parsed(line)
        files, results = (tuple(FileState(*each) for each in found.pop(name)) for name in ("files", "results"))
        faults = tuple((str(message), int(code)) for message, code in found.pop("faults"))
        return Record(**found, files=files, results=results, faults=faults)
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
