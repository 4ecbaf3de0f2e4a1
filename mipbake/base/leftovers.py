"""Unfinished work beside a path: how it is named, who is at work on it, and what becomes of it when nobody is.

`.NAME.1a2b3c4d.partial` will be NAME when it is complete, or is what NAME has replaced: nobody needs it once its
process is gone. `.NAME.1a2b3c4d.old` is an earlier NAME that was moved aside: where there is no NAME, it is the only
one.

The process that is at work on one of them holds a lock on it (flock), which the system gives up when the process ends,
however it ends. Where a system has no such locks, leftovers stay, because nobody can tell whose they are.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mipbake.base.signals import uninterrupted

if sys.platform != "win32":
    import fcntl

PARTIAL, OLD = ".partial", ".old"

_UNFINISHED = re.compile(rf"\.(.+)\.[0-9a-f]{{8}}(?:{re.escape(PARTIAL)}|{re.escape(OLD)})", re.DOTALL)

_unfinished: set[Path] = set()


def unfinished() -> list[Path]:
    """What this process has begun, has not finished, and has not been able to remove."""
    return sorted(path for path in _unfinished if os.path.lexists(path))


def name_beside(place: Path, suffix: str) -> Path:
    """A new name beside a path for unfinished work on it."""
    return place.with_name(f".{place.name}.{secrets.token_hex(4)}{suffix}")


@contextmanager
def begun(place: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    """What `make` makes at a new path beside `place`, locked; what is there when the block ends is removed."""
    with contextlib.ExitStack() as locks:
        partial = name_beside(place, PARTIAL)
        _unfinished.add(partial)
        try:
            make(partial)
            while not locks.enter_context(_lock(partial, wait=True)):  # somebody took it for a leftover: once more
                make(partial)
            yield partial
        finally:
            try:
                _finish(partial)
            except BaseException:  # a signal, before or after signals waited
                _finish(partial)
                raise


@contextmanager
def kept(path: Path) -> Iterator[None]:
    """Keeps others from taking what is at a path, by whatever name, for a leftover while the block runs."""
    with _lock(path, wait=False):
        yield


def tidy(*places: Path) -> None:
    """Removes what processes that are gone left beside paths, and gives an earlier result that was moved aside its name
    back where nothing else has it. Each folder is listed once, however many of the paths lie in it."""
    names: dict[Path, set[str]] = {}
    for place in places:
        names.setdefault(place.parent, set()).add(place.name)
    for folder, wanted in names.items():
        with suppress(OSError):
            for path in folder.iterdir():
                found = _UNFINISHED.fullmatch(path.name)
                if found and found[1] in wanted:
                    with suppress(OSError):
                        _tidy_one(path, folder / found[1])


def remove(path: Path) -> None:
    """Removes a file, or a folder with all that is in it, as far as that is possible."""
    with suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


def _tidy_one(path: Path, place: Path) -> None:
    with _lock(path, wait=False) as ours:
        if not ours:
            return
        with uninterrupted():
            if path.suffix == OLD and not os.path.lexists(place):
                path.rename(place)
            else:
                remove(path)


def _finish(partial: Path) -> None:
    with uninterrupted():
        remove(partial)
        if not os.path.lexists(partial):
            _unfinished.discard(partial)


@contextmanager
def _lock(path: Path, wait: bool) -> Iterator[bool]:
    """Whether this process alone has what lies at a path, for as long as the block runs.

    Args:
        wait: for another process to give it up. Then it is True where locks cannot be had, and False only where the
            path is gone or another's by now; else False in all those cases.
    """
    if sys.platform == "win32":
        yield wait
        return
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        yield wait and os.path.lexists(path)
        return
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            found = os.path.lexists(path) and os.path.samestat(path.lstat(), os.fstat(handle))
        except OSError:
            found = wait and os.path.lexists(path)
        yield found
    finally:
        os.close(handle)
