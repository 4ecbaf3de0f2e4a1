"""How work is kept that goes on later: searches, fits and trainings.

A file is replaced as a whole, after its content is on the disk (`mipbake.base.publish.replacing`), so that whenever a
process is killed, the earlier file or the new one lies there. A process holds a lock on what it keeps, which the system
gives up when the process ends: another one must neither read nor replace it meanwhile.

Arrays are written and read some rows at a time: they may be larger than the memory that a bake holds to. A file of
them is what `numpy.load` reads. The sums that zip files hold of their parts tell where one is damaged. One of the
arrays holds JSON: what the work is, and its settings and counts.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import one_line
from mipbake.base.publish import check_file, parents, replacing, writing

if sys.platform != "win32":
    import fcntl

DAMAGED = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, IndexError),
    *(RuntimeError, tokenize.TokenError),  # of zip files (what looks encrypted, or of a later version), JSON, and NumPy
    *(zipfile.BadZipFile, zlib.error),
)
"""What reading raises where a file is damaged, or is none of these."""

AT_ONCE = 1 << 22
"""Bytes that are copied at a time."""

_ABOUT = "about"

Make = Callable[[tuple[int, ...], np.dtype[Any]], NDArray[Any]]
"""Makes an array of a shape and a dtype, whose values are then read; ValueError where no such array is expected."""


def lock_of(path: Path) -> int | None:
    """A handle that holds a lock until it is closed; None where another process has it.

    Args:
        path: of the lock, an empty file. Only who has the lock may remove it.

    Raises:
        OSError: it cannot be made.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    if sys.platform == "win32":
        return handle
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The process that had it may have removed it.
        if os.path.samestat(path.stat(), os.fstat(handle)):
            return handle
    except BlockingIOError:
        pass
    except OSError:  # a file system without locks, or a folder that is gone
        if path.exists():
            return handle
    os.close(handle)
    return None


@contextlib.contextmanager
def alone_with(path: Path) -> Iterator[None]:
    """Keeps other processes from a file that work is kept in; makes the folders that it lies in.

    Raises:
        UsageError: another process has it. OutputError: the lock, which lies beside it, cannot be made.
    """
    lock = path.with_name(f".{path.name}.lock")
    with contextlib.ExitStack() as held:
        with writing(f"the checkpoint {path} cannot be written"):
            held.enter_context(parents(path))
            handle = lock_of(lock)
        if handle is None:
            raise UsageError(
                f"the checkpoint {path} is in use by another process: wait until that ends, or choose another file"
            )
        held.callback(os.close, handle)
        if sys.platform != "win32":  # there it is no lock, and a file that is open cannot be removed
            held.callback(lock.unlink, missing_ok=True)
        yield


@dataclass(frozen=True)
class Checkpoint:
    """A file that a fit or a training is kept in.

    Args:
        path: of the file.
        kind: what is kept, as in "fit"; `kind` and `format` stand in the file.
        format: number of what the file holds, which grows as that changes.
        instead: what to do where the file cannot be read.
    """

    path: Path
    kind: str
    format: int
    instead: str = "delete it to begin anew"

    def check(self) -> None:
        """OutputError where a file is in the way that is no checkpoint. For before long work."""
        check_file(self.path, _holds_about, f"checkpoint of a {self.kind}")

    def save(self, about: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Replaces the file, as a whole.

        Args:
            about: what JSON holds. arrays: all others.

        Raises:
            OutputError: the file cannot be written.
        """
        with writing(f"the checkpoint {self.path} cannot be written"):
            write_kept(self.path, {"kind": self.kind, "format": self.format, **about}, arrays)

    def load(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """What `save` took.

        Raises:
            InputError: there is no such file, it is damaged, or of another kind or version.
        """
        try:
            arrays = read_arrays(self.path, lambda _: None)
            about: dict[str, Any] = json.loads(arrays.pop(_ABOUT).tobytes())
            if (about["kind"], about["format"]) != (self.kind, self.format):
                raise ValueError(f"it is no {self.kind} of this version")
        except FileNotFoundError as error:
            raise InputError(f"{self.path}: no such checkpoint") from error
        except DAMAGED as error:
            why = one_line(str(error))[:120]
            raise InputError(f"the checkpoint {self.path} cannot be read ({why}): {self.instead}") from error
        return about, arrays


def write_kept(path: Path, about: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> int:
    """`write_arrays` of arrays, and of what JSON holds; returns the bytes."""
    return write_arrays(path, {_ABOUT: np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays})


def read_about(path: Path) -> dict[str, Any]:
    """What a file says of itself in JSON. One of DAMAGED where it cannot be read."""
    with np.load(path) as file:
        about: dict[str, Any] = json.loads(file[_ABOUT].tobytes())
    return about


def _holds_about(path: Path) -> bool:
    """Whether it looks like a checkpoint, whatever of it is damaged."""
    try:
        with zipfile.ZipFile(path) as file:
            return f"{_ABOUT}.npy" in file.namelist()
    except DAMAGED:
        return False


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> int:
    """Replaces a file as a whole, and returns its bytes. OSError where that fails."""
    with replacing(path) as partial, partial.open("wb") as file:
        with zipfile.ZipFile(file, "w") as packed:
            for name, array in arrays.items():
                with packed.open(f"{name}.npy", "w", force_zip64=True) as out:
                    header = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
                    np.lib.format.write_array_header_1_0(out, header)
                    for rows in _some_rows(array):
                        out.write(np.ascontiguousarray(array[rows]).tobytes())
        return file.tell()


def read_arrays(path: Path, make: Callable[[str], Make | None]) -> dict[str, NDArray[Any]]:
    """Reads a file.

    Args:
        make: name of an array to what makes it; None for an array that may be of any shape, and is small.

    Raises:
        One of DAMAGED: it cannot be read, or is damaged.
    """
    found = {}
    with zipfile.ZipFile(path) as packed:
        for entry in packed.infolist():
            name = entry.filename.removesuffix(".npy")
            with packed.open(entry) as stream:
                found[name] = _read(stream, make(name) or np.empty, entry.file_size)
    return found


def _read(stream: IO[bytes], make: Make, size: int) -> NDArray[Any]:
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("it has arrays of another version")
    shape, in_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    if in_columns or dtype.hasobject or math.prod(shape) * max(dtype.itemsize, 1) > size:
        raise ValueError("it has arrays of another kind")
    array = make(shape, dtype)
    for rows in _some_rows(array):
        some = np.empty(array[rows].shape, array.dtype)
        view = memoryview(some.reshape(-1).view(np.uint8).data)
        while view:
            count = stream.readinto(view)  # type: ignore[attr-defined]
            if not count:
                raise EOFError("it ends too soon")
            view = view[count:]
        array[rows] = some
    if stream.read(1):
        raise ValueError("it has more than its arrays")
    return array


def _some_rows(array: NDArray[Any]) -> list[Any]:
    """Parts of an array along its first axis, as indices."""
    if array.ndim == 0 or array.nbytes <= AT_ONCE:
        return [...]
    step = max(1, AT_ONCE * len(array) // array.nbytes)
    return [slice(start, start + step) for start in range(0, len(array), step)]
