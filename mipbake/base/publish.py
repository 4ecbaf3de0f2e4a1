"""Writing a folder so that it is either there, whole, or not there at all."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from mipbake.base.errors import OutputError
from mipbake.base.leftovers import OLD, PARTIAL, begun, kept, name_beside, remove, tidy
from mipbake.base.signals import uninterrupted

IsOurs = Callable[[Path], bool]
"""Whether an existing folder holds an earlier result and nothing else, or a file is one, so that it may be replaced."""

_COMPANIONS = (".meta", ".import")
"""What engines add to the name of a file for what they know of it: Unity and Godot. It moves on to the next result."""

_LITTER = (".DS_Store", "Thumbs.db", "desktop.ini")
"""What file managers leave in folders. It is in nobody's way."""

_BLOCK = 1 << 20  # bytes
TRIAL, TEMPORARY = "mipbake-trial", "mipbake-files"
_TAKEN = (errno.EEXIST, errno.ENOTEMPTY)
_HERE, _EXCHANGE = -100, 2  # AT_FDCWD of fcntl.h, RENAME_EXCHANGE of linux/fs.h


def is_companion(path: Path) -> bool:
    """Whether an engine or a file manager has put a file into a result, which goes with what it is beside."""
    return path.name in _LITTER or (path.suffix in _COMPANIONS and path.with_suffix("").exists())


def check_place(place: Path, is_ours: IsOurs) -> None:
    """Raises OutputError when publishing to `place` cannot succeed; leaves nothing behind. Call it before long work.

    What killed processes left beside `place` is removed, and an earlier result that such a process had moved
    aside gets its name back. Permissions do not tell everything (read-only and virtual file systems, names that are
    too long), so the folders that are missing are made on trial, under a name of their own that no other process
    relies on.
    """
    try:
        str(place.resolve()).encode()
        tidy(place.resolve())
        _check_existing(place, is_ours)
        _try_to_make(place.resolve())
    except UnicodeEncodeError as error:
        shown = os.fsencode(place).decode("utf-8", "backslashreplace")
        raise OutputError(f"cannot write to {shown}: its name is not UTF-8, choose another folder") from error
    except OSError as error:
        raise OutputError(f"cannot write to {place}: {reason(error)}") from error
    except RuntimeError as error:  # what Python says of loops of links before version 3.13
        raise OutputError(
            f"cannot write to {place}: a link leads back to itself, remove it or choose another folder"
        ) from error


def check_file(path: Path, is_ours: IsOurs, what: str) -> None:
    """Raises OutputError where a file that a user named is to be written over something that mipbake did not write.
    Call it before long work.

    An empty file holds nothing that could be lost, and what is written into a device or a pipe replaces nothing. Links
    are followed, as by who writes.

    Args:
        is_ours: whether an existing file is an earlier one of the same kind. what: the kind, in words.
    """
    with writing(f"cannot write {path}"):
        found = _state(path)
        if found is not None and stat.S_ISDIR(found.st_mode):
            raise OutputError(f"cannot write {path}: it is a folder, name a file")
        if found is not None and stat.S_ISREG(found.st_mode) and found.st_size and not is_ours(path):
            raise OutputError(
                f"cannot write {path}: it is there, and is no {what} that mipbake wrote; move it or name another file"
            )


def _check_existing(place: Path, is_ours: IsOurs) -> None:
    for each in (place, *place.parents):
        if each.is_symlink() and not each.exists():
            what = "it" if each == place else each
            raise OutputError(
                f"cannot write to {place}: {what} is a link to nothing, remove it or choose another folder"
            )
    _check_replaceable(place, is_ours)
    # The closest folder that exists must let us create what is missing below it.
    existing = next(p for p in place.resolve().parents if p.exists())
    if not existing.is_dir():
        raise OutputError(f"cannot write to {place}: {existing} is a file, choose another folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write to {place}: no permission to write in {existing}, choose another folder")


def _check_replaceable(place: Path, is_ours: IsOurs) -> None:
    """Looks again where another process has put its result at the same name meanwhile."""
    while (found := _state(place)) is not None:
        foreign = stat.S_ISDIR(found.st_mode) and _listed(place) and not is_ours(place)
        now = _state(place)
        if now is None or not os.path.samestat(now, found):
            continue
        if foreign:
            raise OutputError(
                f"cannot write to {place}: it holds files that are not mipbake's, empty it or choose another folder"
            )
        if not stat.S_ISDIR(found.st_mode):
            raise OutputError(f"cannot write to {place}: it is a file, choose another folder")
        return


def _try_to_make(place: Path) -> None:
    existing = next(p for p in place.parents if p.exists())
    trial = existing / TRIAL
    tidy(trial)
    with begun(trial, Path.mkdir) as folder:
        name_beside(folder / place.relative_to(existing), PARTIAL).mkdir(parents=True)


@contextlib.contextmanager
def published(place: Path, is_ours: IsOurs) -> Iterator[Path]:
    """A temporary folder beside `place`, which takes its name when the block ends and is removed when it raises.

    Parent folders are made as needed, and removed again when the block raises. Wherever the process is
    stopped, `place` is the earlier result or the new one, whole. What engines have put beside files that both have,
    such as Unity's `NAME.meta`, moves on to the new one. Only where a file system cannot exchange two names is
    there neither for a moment; after a process was killed in it, the next `check_place` restores the earlier result.

    Raises:
        OutputError: what check_place says, and whatever the file system refuses on the way.
    """
    check_place(place, is_ours)
    place = place.resolve()
    with writing(f"cannot write to {place}"), parents(place), begun(place, Path.mkdir) as partial:
        yield partial
        _take_over(place, partial)
        _flush(partial)
        _check_existing(place, is_ours)  # it may have been long since the first time
        with uninterrupted():
            _swap(partial, place)
            _flush_names(place.parent)


def _take_over(place: Path, partial: Path) -> None:
    """Copies what engines know of the files of an earlier result to the same files of a new one."""
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):  # there is none, or another process moves it now
        for each in place.iterdir():
            of = partial / each.with_suffix("").name
            if each.suffix in _COMPANIONS and each.is_file() and of.is_file():
                shutil.copy2(each, partial / each.name)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new, empty file beside `path`, which takes its name when the block ends and is removed when it raises. Where
    `path` is a link, all of that is about what it leads to, and the link stays.

    Raises:
        OSError: whatever the file system refuses.
    """
    path = Path(os.path.realpath(path))  # which takes loops of links as they are
    tidy(path)
    with begun(path, lambda partial: partial.touch(exist_ok=False)) as partial:
        yield partial
        _flush(partial)
        partial.replace(path)
        _flush_names(path.parent)


def replaced_file(path: Path, data: bytes) -> None:
    """Writes a file, and the folders that it is in, so that it is either there, whole, or as it was before. Devices and
    pipes are written into. A link stays, and what it leads to is written.

    Raises:
        OutputError: the file system refuses it.
    """
    with writing(f"cannot write {path}"):
        path = Path(os.path.realpath(path))
        if path.exists() and not (path.is_file() or path.is_dir()):
            with path.open("wb") as file:
                file.write(data)
            return
        with parents(path), replacing(path) as partial:
            partial.write_bytes(data)


@contextlib.contextmanager
def temporary_files(parent: Path | None = None) -> Iterator[None]:
    """What the file system refuses in the block concerns temporary files: OutputError says so.

    Args:
        parent: where they lie; None for the system's folder of such.
    """
    try:
        yield
    except OSError as error:
        where = f" in {parent}" if parent else ""
        hint = "" if parent else " (the environment variable TMPDIR names it)"
        raise OutputError(f"cannot write temporary files{where}: {reason(error)}{hint}") from error


@contextlib.contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """A folder for files that are not needed for long, removed when the block ends.

    What killed processes left of theirs beside it is removed, too.

    Args:
        parent: where it lies; None for the system's folder of such.

    Raises:
        OutputError: it cannot be made.
    """
    with contextlib.ExitStack() as held:
        with temporary_files(parent):
            place = (parent or Path(tempfile.gettempdir())) / TEMPORARY
            tidy(place)
            folder = held.enter_context(begun(place, lambda path: path.mkdir(mode=0o700)))
        yield folder


def write_temporary(path: Path, data: bytes | memoryview) -> None:
    """Writes a file into a temporary folder. OutputError where that fails."""
    with temporary_files():
        path.write_bytes(data)


def check_room(path: Path, size: int) -> None:
    """Raises OSError where an unfinished file takes no more bytes. Its content is lost.

    For libraries that do not say why they could not write: what is full, or too long, refuses other bytes as well. They
    stay until the file is removed, so that nothing that is written meanwhile finds room and another reason.

    Args:
        size: how many bytes were still to be written, at most.
    """
    block = secrets.token_bytes(_BLOCK)  # file systems that compress must not find room for them
    with path.open("ab", buffering=0) as file:
        for _ in range(-(-size // _BLOCK) + 1):
            written = file.write(block) or 0
            if written < _BLOCK:
                file.write(block[written:])


def reason(error: OSError) -> str:
    """Why the file system refused, and what to do."""
    if error.errno == errno.ENOSPC:
        return "the disk is full, make room or choose another folder"
    if error.errno == errno.EDQUOT:
        return "the quota for files is used up, make room or choose another folder"
    if error.errno == errno.EFBIG:
        return "the file is larger than its file system or a limit of the session allows, choose another folder"
    if error.errno == errno.ENAMETOOLONG:
        return "the name is too long, choose a shorter one"
    return f"{error.strerror or error}, check the folder's permissions or choose another"


@contextlib.contextmanager
def writing(what: str) -> Iterator[None]:
    """What the file system refuses in the block becomes an OutputError that begins with `what`."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{what}: {reason(error)}") from error


@contextlib.contextmanager
def parents(path: Path) -> Iterator[None]:
    """The folders that a path lies in, made where they are missing, and removed again when the block raises."""
    made: list[Path] = []
    done = False
    try:
        for parent in reversed([p for p in path.parents if not p.exists()]):
            made.append(parent)
            parent.mkdir(exist_ok=True)  # another process may be as quick
        yield
        done = True
    finally:
        for parent in reversed([] if done else made):
            with contextlib.suppress(OSError):  # not empty: another process writes there too
                parent.rmdir()


def _flush(path: Path) -> None:
    """Waits until a file, or all files below a folder, are on the disk: some file systems say only then what failed."""
    for file in [path] if path.is_file() else [each for each in path.rglob("*") if each.is_file()]:
        with file.open("rb+") as opened:
            os.fsync(opened.fileno())


def _flush_names(folder: Path) -> None:
    """Waits until the names in a folder are on the disk, where a system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _swap(partial: Path, place: Path) -> None:
    """Gives a folder its name. An earlier folder of that name lies at `partial` then, or is gone.

    Raises:
        OSError: the file system refuses it; then everything is as it was.
    """
    while not exchanged(partial, place):
        try:
            partial.rename(place)  # there is none, or an empty one
            return
        except OSError as error:
            if error.errno not in _TAKEN and not os.path.lexists(place):
                raise
        old = name_beside(place, OLD)
        with kept(place):
            try:
                place.rename(old)
            except FileNotFoundError:  # another process has moved it: once more
                continue
            try:
                partial.rename(place)
            except OSError as error:
                if error.errno not in _TAKEN and not os.path.lexists(place):
                    _give_back(old, place, error)
                    raise
                remove(old)  # another process was quicker: its result is what is to be replaced
                continue
            remove(old)
            return


def _give_back(old: Path, place: Path, error: OSError) -> None:
    """Gives an earlier result its name back. OutputError, which says where it is, where that fails, too."""
    try:
        old.rename(place)
    except FileNotFoundError:  # another process has done so
        pass
    except OSError:
        raise OutputError(
            f"cannot write to {place}: {reason(error)}; the earlier result is {old}, and the next bake of it gives it "
            "its name back"
        ) from error


def exchanged(first: Path, second: Path) -> bool:
    """Exchanges the names of two folders in one step; False where that cannot be had."""
    if sys.platform != "linux":
        return False
    try:
        exchange = ctypes.CDLL(None).renameat2
    except (OSError, AttributeError):  # an old C library
        return False
    return bool(exchange(_HERE, os.fsencode(first), _HERE, os.fsencode(second), _EXCHANGE) == 0)


def _state(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _listed(folder: Path) -> bool:
    try:
        return any(folder.iterdir())
    except FileNotFoundError:
        return False
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {reason(error)}") from error
