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
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake.errors import InputError, OutputError
from mipbake.io import disk
from mipbake.io.matches import is_textures

FOLDER = ".mipbake"
_FILE = "batch.sqlite"
_SCHEMA = 2

FRESH = 2_000_000_000
"""Nanoseconds: file systems tell times as coarsely as two seconds, so a younger file may change and keep its time."""


@dataclass(frozen=True)
class FileState:
    """A file, without a look at what is in it.

    Args:
        path: relative to the folder that the list of files is about.
        size: in bytes; -1 for a file that is not there.
        modified: in nanoseconds; -1 where the file was so young that its time does not tell whether it changed.
    """

    path: str
    size: int
    modified: int


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
    fresh = not ours and time.time_ns() - found.st_mtime_ns < FRESH
    return FileState(told, found.st_size, -1 if fresh else found.st_mtime_ns)


def states(source: Path, others: Iterable[Path] = ()) -> tuple[FileState, ...]:
    """The states of all files that decide what a source is baked to: all files of a folder, because names decide which
    of them are maps; or the source, and what it refers to.

    Args:
        others: files that it refers to.
    """
    paths = dict.fromkeys([*_own_files(source), *others])
    return tuple(state_of(path, source.parent) for path in paths)


def _own_files(source: Path) -> Iterator[Path]:
    folder = source if source.is_dir() else source.parent if "<" in source.name else None
    if folder is None:
        yield source
        return
    with suppress(InputError):  # its turn will say so
        yield from disk.files_in(folder)
        for inner in disk.folders_in(folder):
            if is_textures(inner):
                yield from disk.files_in(inner)


def is_unchanged(known: Known, source: Path, out: Path) -> bool:
    """Whether nothing has changed since an entry was baked, as far as sizes and times of files tell.

    Args:
        known: of the last time. source: of the entry. out: folder of all results.
    """
    before = {file.path: file for file in known.files}
    own = {os.path.relpath(path, source.parent) for path in _own_files(source)}
    if not own <= set(before) or not all(_same(file, source.parent) for file in known.files):
        return False
    return all(_same(file, out, ours=True) for file in known.results)


def _same(file: FileState, folder: Path, ours: bool = False) -> bool:
    now = state_of(folder / file.path, folder, ours)
    return now.size == -1 if file.size == -1 else file.modified != -1 and now == file


class States:
    """The database. It is written by one process at a time."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def known(self, label: str, key: str) -> Known | None:
        """What is known of an entry that was baked with the options of that key; None where nothing is."""
        row = self._connection.execute("select content from entries where label = ? and key = ?", (label, key))
        found = row.fetchone()
        return None if found is None else _known(found[0])

    def last(self, label: str) -> Known | None:
        """What is known of an entry, whatever it was baked with."""
        row = self._connection.execute("select content from entries where label = ?", (label,)).fetchone()
        return None if row is None else _known(row[0])

    def is_place_of(self, label: str, source: Path) -> bool:
        """Whether an entry was baked before, with whatever options, so that what lies at its place is its own."""
        row = self._connection.execute("select source from entries where label = ?", (label,)).fetchone()
        return row is not None and row[0] == _told(source)

    def remember(self, label: str, source: Path, key: str, known: Known) -> None:
        """Keeps what is known of an entry."""
        both = ([[f.path, f.size, f.modified] for f in files] for files in (known.files, known.results))
        row = (label, _told(source), key, json.dumps([known.count, *both, known.faults]))
        with self._connection:
            self._connection.execute("insert or replace into entries values (?, ?, ?, ?)", row)


def _told(source: Path) -> str:
    return os.fsencode(os.path.abspath(source)).decode(errors="backslashreplace")  # noqa: PTH100  links stay


def _known(content: str) -> Known | None:
    try:
        count, files, results, faults = json.loads(content)
        return Known(
            tuple(FileState(str(p), int(s), int(m)) for p, s, m in files),
            tuple(FileState(str(p), int(s), int(m)) for p, s, m in results),
            int(count),
            tuple((str(message), int(code)) for message, code in faults),
        )
    except (ValueError, TypeError):
        return None


@contextmanager
def opened(out: Path, write: bool = True) -> Iterator[States]:
    """The database of a folder of results; a damaged one is begun anew.

    Args:
        write: whether it is made where there is none; else what is remembered is forgotten.

    Raises:
        OutputError: it cannot be written.
    """
    place = out / FOLDER / _FILE
    if not write and not place.is_file():
        yield States(_begun(sqlite3.connect(":memory:")))
        return
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        connection = _connected(place)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(
            f"cannot write {place} ({error}): check the folder's permissions or choose another"
        ) from error
    try:
        yield States(connection)
    finally:
        connection.close()


def _connected(place: Path) -> sqlite3.Connection:
    for _ in range(2):
        connection = sqlite3.connect(place, timeout=60)
        try:
            return _begun(connection)
        except sqlite3.OperationalError:  # it is locked, or its folder cannot be written: nothing is wrong with it
            connection.close()
            raise
        except sqlite3.DatabaseError:
            connection.close()
            place.unlink(missing_ok=True)
    raise sqlite3.DatabaseError("it is damaged, and damaged again")


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
