"""A library under watch: what somebody saves is baked at once."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.extras import extra
from mipbake.library.listing import Library
from mipbake.library.state import FileState, States

QUIET = 100
"""Milliseconds without another change after which changes are looked at: programs write a file in several steps."""

_LONGEST = 800
"""Milliseconds of changes without a pause after which they are looked at all the same."""

_BEAT = 500
"""Milliseconds after which a watch that has seen nothing says so; the first time, it is known to have begun."""


def watched(sources: Sequence[Path]) -> list[Path]:
    """The folders in which sources lie, or which they are."""
    folders = [path if path.is_dir() else path.parent for path in sources]
    return [each for each in dict.fromkeys(folders) if not any(disk.lies_in(each, o) for o in folders if o != each)]


def changes(folders: Sequence[Path], out: Path) -> Iterator[set[Path] | None]:
    """Files that change below folders, without end: sets of paths that change together.

    Args:
        folders: that are watched, with all folders in them. out: the folder of all results, which is passed over.

    Yields:
        First None: the watch has begun, and what changed before is not known. Then sets of paths.

    Raises:
        UsageError: the extra `watch` is not installed. InputError: the system watches no more files.
    """
    with extra("watch", "--watch"):
        import watchfiles
    results, begun = disk.resolved(out), False
    try:
        beats = watchfiles.watch(
            *folders, watch_filter=None, debounce=_LONGEST, step=QUIET, rust_timeout=_BEAT, yield_on_timeout=True
        )
        for found in beats:
            if not begun:
                begun = True
                yield None
                continue
            paths = {Path(os.path.realpath(path)) for _, path in found}
            if inside := {path for path in paths if not disk.lies_in(path, results)}:
                yield inside
    except OSError as error:
        raise InputError(
            f"{', '.join(map(str, folders))} cannot be watched ({error.strerror or error}): let the system watch more "
            "files (on Linux fs.inotify.max_user_watches), or bake without --watch"
        ) from error


def touched(
    library: Library, paths: Iterable[Path] | None, states: States, find: Callable[[], Library]
) -> tuple[Library, Library]:
    """The library, and what of it may have changed. The library is looked through again where files are new or gone.

    Args:
        library: as it was. paths: files that changed; None where they are not known.
        states: which files its entries were baked from. find: finds the library again.
    """
    if paths is not None:
        known = [(entry, states.records.get(entry.label)) for entry in library.entries]
        own = [(entry, _real(entry.source.parent, record.files)) for entry, record in known if record is not None]
        every = frozenset[str]().union(*(files for _, files in own))
        # What is gone and was never a part of an entry, or around one, is a file that a program saved into at first.
        changed = {p for p in map(os.path.realpath, paths) if p in every or os.path.lexists(p) or _is_around(p, every)}
        if all(p in every and Path(p).is_file() for p in changed):
            return library, Library(tuple(entry for entry, files in own if changed & files))
    try:
        found = find()
    except InputError:  # the last source is gone: there may be another
        found = Library(())
    return found, found


def _is_around(folder: str, files: Iterable[str]) -> bool:
    inside = f"{folder}{os.sep}"
    return any(file.startswith(inside) for file in files)


@lru_cache(maxsize=1 << 16)
def _real(folder: Path, files: tuple[FileState, ...]) -> frozenset[str]:
    """Real paths of files that are relative to a folder. They are looked up again where something of them is new."""
    return frozenset(os.path.realpath(folder / file.path) for file in files)
