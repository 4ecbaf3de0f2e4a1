"""What the file system is asked before anything is read, with one sentence for whatever it refuses.

Everything that users name goes through here: an `OSError` of reading becomes an `InputError` in this file alone, and
nothing but regular files is opened, because opening a pipe waits for a writer that may never come.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from mipbake.base.errors import InputError

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_ABSENT = (errno.ENOENT, errno.ENOTDIR)


def refused(path: Path, error: OSError, expected: str = "") -> InputError:
    """The sentence for what the file system says of a path that was to be read; `expected` is what should lie there."""
    if error.errno == errno.ENAMETOOLONG:
        return InputError(f"{path} is longer than a name can be: give the path of a file or folder")
    if error.errno == errno.ELOOP:
        return InputError(f"{path} is a link that leads back to itself: remove it, or give what it should lead to")
    wanted = f"expected {expected}, " if expected else ""
    return InputError(
        f"{path} cannot be read ({error.strerror or error}): {wanted}check that it is there, and its permissions"
    )


@contextmanager
def reading(path: Path, expected: str = "") -> Iterator[None]:
    """Turns an OSError into an InputError about `path`, or about the file that the error itself names."""
    try:
        yield
    except OSError as error:
        named = path if error.filename is None else Path(os.fsdecode(error.filename))
        raise refused(named, error, expected) from error


def is_file(path: Path) -> bool:
    """Whether a regular file lies there, links followed; InputError where the file system does not tell."""
    mode = _mode(path)
    return mode is not None and stat.S_ISREG(mode)


def is_dir(path: Path) -> bool:
    """Whether a folder lies there, links followed; InputError where the file system does not tell."""
    mode = _mode(path)
    return mode is not None and stat.S_ISDIR(mode)


def exists(path: Path) -> bool:
    """Whether anything lies there, links followed; InputError where the file system does not tell."""
    return _mode(path) is not None


def entries(folder: Path) -> list[Path]:
    """What lies in a folder, sorted; InputError where it cannot be listed."""
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder} cannot be listed ({error.strerror}): check its permissions") from error


def is_readable_folder(folder: Path) -> bool:
    """Whether a folder can be listed and entered."""
    try:
        os.scandir(folder).close()
        os.stat(os.path.join(folder, os.curdir))  # noqa: PTH116, PTH118  Path would leave the dot out
    except OSError:
        return False
    return True


def files_in(folder: Path) -> list[Path]:
    """The regular files of a folder that are not hidden, sorted; links to nothing and loops of links are left out."""
    with reading(folder):  # a folder that may be listed but not entered tells nothing of what lies in it
        return [path for path in entries(folder) if not path.name.startswith(".") and path.is_file()]


def folders_in(folder: Path) -> list[Path]:
    """The folders in a folder that are not hidden, sorted; links to nothing and loops of links are left out."""
    with reading(folder):
        return [path for path in entries(folder) if not path.name.startswith(".") and path.is_dir()]


def resolved(path: Path) -> Path:
    """The path without links; InputError for a loop of links."""
    try:
        return path.resolve()
    except RuntimeError:  # what Python says of loops before version 3.13
        raise refused(path, OSError(errno.ELOOP, os.strerror(errno.ELOOP))) from None
    except OSError as error:
        raise refused(path, error) from error


def lies_in(path: Path, folder: Path) -> bool:
    """Whether a path lies in a folder by its words alone, links not followed."""
    return Path(os.path.abspath(path)).is_relative_to(os.path.abspath(folder))  # noqa: PTH100  resolve follows links


def check_file(path: Path, expected: str = "") -> None:
    """InputError unless a regular file lies there, which may be handed to a library that opens it itself."""
    with reading(path, expected):
        mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        what = next((name for test, name in _KINDS if test(mode)), "something else")
        raise InputError(f"{path} is {what}: expected {expected or 'a file'}")


@contextmanager
def opened(path: Path, expected: str = "") -> Iterator[BinaryIO]:
    """A regular file, open for reading; InputError for anything else, and for what goes wrong while it is read."""
    check_file(path, expected)
    with reading(path, expected), path.open("rb") as file:
        yield file


def read_bytes(path: Path, expected: str = "") -> bytes:
    """All bytes of a regular file; InputError where they cannot be had."""
    with opened(path, expected) as file:
        return file.read()


def read_text_or_pipe(path: Path, expected: str = "") -> str:
    """Text in UTF-8 of a file, or of a pipe such as a shell's <(...); nothing where nobody writes to the pipe.

    Raises:
        InputError: it cannot be read. UnicodeDecodeError: it is not UTF-8.
    """
    with reading(path, expected):
        if not stat.S_ISFIFO(path.stat().st_mode):
            return read_bytes(path, expected).decode("utf-8-sig")
        # To open it as usual would wait for a writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as pipe:  # noqa: PTH123
            os.set_blocking(pipe.fileno(), True)
            return pipe.read().decode("utf-8-sig")


def _mode(path: Path) -> int | None:
    try:
        return path.stat().st_mode
    except OSError as error:
        if error.errno in _ABSENT:
            return None
        raise refused(path, error) from error
    except ValueError:  # a zero byte, which no name has
        return None
