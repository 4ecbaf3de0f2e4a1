"""Writing a folder so that it is either there, whole, or not there at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from mipbake.errors import OutputError

IsOurs = Callable[[Path], bool]
"""Whether an existing folder holds an earlier result and nothing else, so that it may be replaced."""


def check_target(target: Path, is_ours: IsOurs) -> None:
    """Raises OutputError when publishing to `target` cannot succeed; leaves nothing behind. Call it before long work.

    Permissions do not tell everything (read-only and virtual file systems, names that are too long), so the folders
    that are missing are made on trial, under a name of their own that no other process relies on.
    """
    try:
        str(target.resolve()).encode()
        _check_existing(target, is_ours)
        _try_to_make(target.resolve())
    except UnicodeEncodeError as error:
        shown = os.fsencode(target).decode("utf-8", "backslashreplace")
        raise OutputError(f"cannot write to {shown}: its name is not UTF-8, choose another folder") from error
    except OSError as error:
        raise OutputError(f"cannot write to {target}: {_reason(error)}") from error
    except RuntimeError as error:  # what Python says of loops of links before version 3.13
        raise OutputError(
            f"cannot write to {target}: a link leads back to itself, remove it or choose another folder"
        ) from error


def _check_existing(target: Path, is_ours: IsOurs) -> None:
    for each in (target, *target.parents):
        if each.is_symlink() and not each.exists():
            what = "it" if each == target else each
            raise OutputError(
                f"cannot write to {target}: {what} is a link to nothing, remove it or choose another folder"
            )
    if target.exists():
        if not target.is_dir():
            raise OutputError(f"cannot write to {target}: it is a file, choose another folder")
        if _listed(target) and not is_ours(target):
            raise OutputError(
                f"cannot write to {target}: it holds files that are not mipbake's, empty it or choose another folder"
            )
    # The closest folder that exists must let us create what is missing below it.
    existing = next(p for p in target.resolve().parents if p.exists())
    if not existing.is_dir():
        raise OutputError(f"cannot write to {target}: {existing} is a file, choose another folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write to {target}: no permission to write in {existing}, choose another folder")


def _try_to_make(target: Path) -> None:
    existing = next(p for p in target.parents if p.exists())
    trial = existing / f".{secrets.token_hex(8)}.partial"
    try:
        trial.mkdir()
        _partial_name(trial / target.relative_to(existing)).mkdir(parents=True)
    finally:
        shutil.rmtree(trial, ignore_errors=True)


@contextlib.contextmanager
def published(target: Path, is_ours: IsOurs) -> Iterator[Path]:
    """A temporary folder beside `target`, renamed to it when the block ends and removed when it raises.

    Parent folders are made as needed, and removed again when the block raises. An earlier result stands until the new
    one is complete, and comes back if the final rename fails.

    Raises:
        OutputError: what check_target says, and whatever the file system refuses on the way.
    """
    check_target(target, is_ours)
    target = target.resolve()
    made: list[Path] = []
    partial = _partial_name(target)
    done = False
    try:
        try:
            for parent in reversed([p for p in target.parents if not p.exists()]):
                with contextlib.suppress(FileExistsError):  # another process was as quick
                    parent.mkdir()
                    made.append(parent)
            partial.mkdir()
            yield partial
            _swap(partial, target)
        except OSError as error:
            raise OutputError(f"cannot write to {target}: {_reason(error)}") from error
        done = True
    finally:
        if not done:
            shutil.rmtree(partial, ignore_errors=True)
            for parent in reversed(made):
                with contextlib.suppress(OSError):  # not empty: another process writes there too
                    parent.rmdir()


def replaced_file(path: Path, data: bytes) -> None:
    """Writes a file so that it is either there, whole, or as it was before. OutputError where that fails."""
    partial = _partial_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data)
        partial.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {_reason(error)}") from error
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder for files that a library must have, removed when the block ends. OutputError where that fails."""
    try:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            yield Path(folder)
    except OSError as error:
        raise OutputError(
            f"cannot write temporary files: {_reason(error)} (the environment variable TMPDIR names it)"
        ) from error


def _partial_name(target: Path) -> Path:
    return target.with_name(f".{target.name}.{secrets.token_hex(4)}.partial")


def _swap(partial: Path, target: Path) -> None:
    if not target.exists():
        partial.rename(target)
        return
    old = partial.with_suffix(".old")
    target.rename(old)
    try:
        partial.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _listed(folder: Path) -> bool:
    try:
        return any(folder.iterdir())
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {_reason(error)}") from error


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "the disk is full, make room or choose another folder"
    if error.errno == errno.EDQUOT:
        return "the quota for files is used up, make room or choose another folder"
    if error.errno == errno.EFBIG:
        return "the file is larger than its file system or a limit of the session allows, choose another folder"
    if error.errno == errno.ENAMETOOLONG:
        return "the name is too long, choose a shorter one"
    return f"{error.strerror or error}, check the folder's permissions or choose another"
