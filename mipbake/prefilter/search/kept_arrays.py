"""Arrays in a file, written and read some rows at a time: they may be larger than the memory that a bake holds to.

A file is what `numpy.load` reads. The sums that zip files hold of their parts tell where one is damaged.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

AT_ONCE = 1 << 22
"""Bytes that are copied at a time. A guess."""

Make = Callable[[tuple[int, ...], np.dtype[Any]], NDArray[Any]]
"""Makes an array of a shape and a dtype, whose values are then read; ValueError where no such array is expected."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> int:
    """Writes a new file, waits until it is on the disk, and returns its bytes. OSError where that fails."""
    with path.open("wb") as file:
        with zipfile.ZipFile(file, "w") as packed:
            for name, array in arrays.items():
                with packed.open(f"{name}.npy", "w", force_zip64=True) as out:
                    header = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
                    np.lib.format.write_array_header_1_0(out, header)
                    for rows in _some_rows(array):
                        out.write(np.ascontiguousarray(array[rows]).tobytes())
        file.flush()
        os.fsync(file.fileno())
        return file.tell()


def read_arrays(path: Path, make: Callable[[str], Make | None]) -> dict[str, NDArray[Any]]:
    """Reads a file.

    Args:
        make: name of an array to what makes it; None for an array that may be of any shape, and is small.

    Raises:
        OSError, ValueError, EOFError, zipfile.BadZipFile: it cannot be read, or is damaged.
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
    if in_columns or dtype.hasobject or math.prod(shape) * dtype.itemsize > size:
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
