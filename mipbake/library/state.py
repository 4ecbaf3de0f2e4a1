"""What is known of the entries of a library from the last time, so that what has not changed need not be read.

It lies in a database beside the results and is a shortcut alone. Whether a result is what it would be baked to again
stands in the result itself (`mipbake.baking.recipe`). Without the database, or where it is damaged, everything is
read and compared, and nothing is baked that need not be.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from mipbake.base import disk, json_text
from mipbake.base.errors import InputError
from mipbake.base.publish import TRIAL
from mipbake.library.listing import Entry
from mipbake.source.archives import MATERIALX
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.matches import is_textures
from mipbake.source.tiles import is_pattern
from mipbake.stack.output import GLB

FOLDER = ".mipbake"
_SUFFIX = ".sqlite"
_SCHEMA = 3
_PATIENCE = 5  # seconds that another process may write

FRESH = 2_000_000_000
"""Nanoseconds: file systems tell times as coarsely as two seconds, so a younger file may change and keep its time."""


@dataclass(frozen=True)
class FileState:
    """A file, without a look at what is in it.

    Args:
        path: relative to the folder that the list of files is about.
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
class Known:
    """What is known of an entry.

    Args:
        files: that it was baked from, relative to the folder around the source.
        results: files of its results, relative to the folder of all results.
        count: how many results there are.
        faults: what is wrong with files of it, each a sentence with the exit code of its error.
    """

    files: tuple[FileState, ...]
    results: tuple[FileState, ...]
    count: int
    faults: tuple[tuple[str, int], ...] = ()


def state_of(path: Path, folder: Path, ours: bool = False) -> FileState:
    """The state of a file; its path is told relative to a folder. `ours`: nobody changes it who has written it."""
    told = os.path.relpath(path, folder)
    try:
        found = path.stat()
    except OSError:
        return FileState(told, -1, -1)
    fresh = not ours and 0 <= time.time_ns() - found.st_mtime_ns < FRESH
    return FileState(told, found.st_size, -1 if fresh else found.st_mtime_ns, 0 if ours else found.st_ctime_ns)


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
    if entry.part is not None:
        yield from (source / file for file in entry.part.files)
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


def sources_are_same(known: Known, entry: Entry) -> bool:
    """Whether no file that an entry was baked from has changed since, as far as sizes and times tell.

    Args:
        known: of the last time. entry: as it is now. Which files a MaterialX document is about is not known without a
            look into it, because it may include others, and stand for tiles that are new.
    """
    source = entry.source
    if source.suffix.lower() == MATERIALX:
        return False
    before = {file.path for file in known.files}
    own = {os.path.relpath(path, source.parent) for path in _own_files(entry)}
    return own <= before and all(_same(file, source.parent) for file in known.files)


def results_are_same(known: Known, out: Path) -> bool:
    """Whether the results in a folder are the files that were written last."""
    return all(_same(file, out, ours=True) for file in known.results)


def places_of(known: Known, out: Path) -> set[Path]:
    """Folders and files beside which unfinished work on the results of an entry lies, without links: the results
    themselves, and what folders are made on trial as. `out`: the folder of all results."""
    files = [PurePath(each.path) for each in known.results]
    named = {file if file.suffix == f".{GLB}" else file.parent for file in files}
    places = {Path(os.path.realpath(out / each)) for each in named}
    return places | {place.with_name(TRIAL) for place in places}


def _same(file: FileState, folder: Path, ours: bool = False) -> bool:
    now = state_of(folder / file.path, folder, ours)
    return now.size == -1 if file.size == -1 else file.modified != -1 and now == file


class States:
    """The database. It is written by one process at a time.

    Args:
        beside: databases of the same folder, of other parts of the library.

    It is a shortcut, so nothing ends where it cannot be read or written: then it knows nothing, and remembers nothing.
    """

    def __init__(self, connection: sqlite3.Connection, beside: Sequence[Path] = ()) -> None:
        self._connection: sqlite3.Connection | None = connection
        self._beside = beside
        self.damaged = False

    def known(self, label: str, source: Path, key: str) -> Known | None:
        """What is known of an entry that was baked with the options of that key; None where nothing is."""
        query = "select content from entries where label = ? and source = ? and key = ?"
        rows = self._rows(query, _text(label), _told(source), key)
        return _known(rows[0][0]) if rows else None

    def last(self, label: str) -> Known | None:
        """What is known of an entry, whatever it was baked with."""
        rows = self._rows("select content from entries where label = ?", _text(label))
        return _known(rows[0][0]) if rows else None

    def places(self, sources: Iterable[Path]) -> set[str] | None:
        """Folders of results that other results may replace, relative to the folder of all results: results of sources
        of one library, and of sources that are gone. None where nothing is known at all.

        Args:
            sources: of the library.
        """
        own = {_told(source) for source in sources}
        query = "select source, content from entries"
        rows = self._rows(query) + [row for path in self._beside for row in _rows_of(path, query)]
        free = [_known(content) for source, content in rows if source in own or not os.path.lexists(source)]
        found = {PurePath(file.path).parent.as_posix() for each in free if each for file in each.results}
        return found if rows else None

    def without_source(self, labels: Collection[str]) -> list[Known]:
        """What is known of entries with other labels than these, all of whose files are gone."""
        there = {_text(label) for label in labels}
        rows = self._rows("select label, source, content from entries order by label")
        others = ((Path(source).parent, _known(content)) for label, source, content in rows if label not in there)
        return [
            known
            for folder, known in others
            if known and known.files and not any(os.path.lexists(folder / file.path) for file in known.files)
        ]

    def remember(self, label: str, source: Path, key: str, known: Known) -> None:
        """Keeps what is known of an entry."""
        files = [[f.path, f.size, f.modified, f.changed] for f in known.files]
        results = [[f.path, f.size, f.modified, f.changed] for f in known.results]
        row = (_text(label), _told(source), key, json.dumps([known.count, files, results, known.faults]))
        self._rows("insert or replace into entries values (?, ?, ?, ?)", *row)

    def is_empty(self) -> bool:
        """Whether it can be read, and nothing is known of any entry."""
        return not self._rows("select label from entries limit 1") and self._connection is not None

    def _rows(self, query: str, *values: str) -> list[tuple[str, ...]]:
        if self._connection is None:
            return []
        try:
            with self._connection:
                return self._connection.execute(query, values).fetchall()
        except sqlite3.Error as error:
            self.damaged = isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.OperationalError)
            self._connection = None
            return []


def _rows_of(path: Path, query: str) -> list[tuple[str, ...]]:
    """Rows of another database, as far as it can be read."""
    found = _read_only(path)
    return [] if found is None else States(found)._rows(query)


def _text(label: str) -> str:
    """A label as text that every database takes: names of files need not be UTF-8."""
    return os.fsencode(label).decode(errors="backslashreplace")


def _told(source: Path) -> str:
    return os.fsencode(os.path.abspath(source)).decode(errors="backslashreplace")  # noqa: PTH100  links stay


def _known(content: str) -> Known | None:
    try:
        count, files, results, faults = json_text.parsed(content)
        return Known(
            tuple(FileState(str(p), int(s), int(m), int(c)) for p, s, m, c in files),
            tuple(FileState(str(p), int(s), int(m), int(c)) for p, s, m, c in results),
            int(count),
            tuple((str(message), int(code)) for message, code in faults),
        )
    except (ValueError, TypeError):
        return None


@contextmanager
def opened(out: Path, name: str = "batch", write: bool = True) -> Iterator[States]:
    """The database of a folder of results. Where it cannot be had, nothing is known; a damaged one is begun anew.

    One in which nothing was remembered does not stay, nor do the folders that were made for it.

    Args:
        name: of the database.
        write: whether it is made where there is none; else what is remembered is forgotten.
    """
    place = out / FOLDER / f"{name}{_SUFFIX}"
    made = [folder for folder in (place.parent, *place.parent.parents) if write and not os.path.lexists(folder)]
    found = _connected(place, write)
    connection = found or _begun(sqlite3.connect(":memory:"))
    beside = [path for path in sorted(place.parent.glob(f"*{_SUFFIX}")) if path != place]
    states = States(connection, beside)
    try:
        yield states
    finally:
        useless = write and found is not None and (states.is_empty() or states.damaged)
        connection.close()
        if useless:
            with suppress(OSError):
                place.unlink()
                for folder in made:  # as far as nothing else lies in them
                    folder.rmdir()


def _connected(place: Path, write: bool) -> sqlite3.Connection | None:
    if not write:
        return _read_only(place)
    for _ in range(2):
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(place, timeout=_PATIENCE)
        except (OSError, sqlite3.Error):
            return None
        try:
            return _begun(connection)
        except sqlite3.OperationalError:  # it is locked, or cannot be written: nothing is wrong with it
            connection.close()
            return None
        except sqlite3.DatabaseError:
            connection.close()
            with suppress(OSError):
                place.unlink()
    return None


def _read_only(place: Path) -> sqlite3.Connection | None:
    try:
        connection = sqlite3.connect(f"{place.resolve().as_uri()}?mode=ro", uri=True, timeout=_PATIENCE)
        current = connection.execute("pragma user_version").fetchone()[0] == _SCHEMA
    except (OSError, sqlite3.Error):
        return None
    return connection if current else None


def _begun(connection: sqlite3.Connection) -> sqlite3.Connection:
    if connection.execute("pragma user_version").fetchone()[0] != _SCHEMA:
        with connection:
            connection.execute("drop table if exists entries")
            connection.execute("create table entries (label text primary key, source text, key text, content text)")
            connection.execute(f"pragma user_version = {_SCHEMA}")
    return connection


def key_of(*parts: Any) -> str:
    """One hash of everything that is asked for an entry."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
