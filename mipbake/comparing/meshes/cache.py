"""Files of unfinished work that may be continued, named by the content they were made from.

What decides the result decides the name (`content_key`), so nothing in the folder is ever out of date, and whatever is
wrong with it, or with the folder, costs no more than the work done again. The files are .npz archives.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LIMIT = 1 << 30
"""Bytes that the files of a folder take at most, together."""

_SUFFIX, _PART = ".mipbake.npz", ".mipbake.part"  # what is ours in the folder, finished and not
_ABANDONED = 3600.0  # seconds after which a file that never got its name is taken to be of a process that died

# What reading a file can raise that is not an archive of plain arrays, or not a whole archive.
_UNREADABLE = (
    OSError, ValueError, KeyError, EOFError, TypeError, AttributeError, RuntimeError, MemoryError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip


def default_folder() -> Path:
    """Where the platform keeps what programs can make again: `$XDG_CACHE_HOME/mipbake`, or `~/.cache/mipbake`.

    On macOS `~/Library/Caches/mipbake`, on Windows `%LOCALAPPDATA%\\mipbake\\Cache`. Nothing is created.
    """
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA", "")
        return (Path(local) if local else Path.home() / "AppData" / "Local") / "mipbake" / "Cache"
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    if Path(chosen).is_absolute():  # the XDG Base Directory Specification ignores any other
        return Path(chosen) / "mipbake"
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "mipbake"


def content_key(**ingredients: object) -> str:
    """SHA-256, in hexadecimal, of named arrays, numbers and strings, and tuples of these.

    Arrays of another dtype or shape are other content, and so is an integer beside a float of equal value.
    """
    digest = hashlib.sha256()
    for name, value in sorted(ingredients.items()):
        for each in value if isinstance(value, tuple) else (value,):
            array = np.ascontiguousarray(each)
            digest.update(f"{name} {array.dtype.str} {array.shape}:".encode())
            digest.update(array.tobytes())
    return digest.hexdigest()


def load(folder: Path, key: str) -> dict[str, NDArray[Any]] | None:
    """The arrays that were saved under that key; None where there are none, or none that can be read whole."""
    path = folder / (key + _SUFFIX)
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except _UNREADABLE:
        return None
    with suppress(OSError):
        os.utime(path)  # files are removed by the age of their last use
    return arrays


def save(folder: Path, key: str, arrays: Mapping[str, NDArray[Any]], limit: int = LIMIT) -> None:
    """Saves arrays under a key, in place of what was there, and removes the oldest files beyond `limit` bytes.

    A reader sees the old file or the new one, whole. Nothing is saved, and nothing raised, where the arrays are larger
    than the limit or the folder cannot be written.
    """
    if sum(array.nbytes for array in arrays.values()) > limit:
        return
    values: dict[str, Any] = dict(arrays)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(_PART, "", folder)
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, **values)
            Path(part).replace(folder / (key + _SUFFIX))
        except BaseException:
            Path(part).unlink()
            raise
        _prune(folder, limit, folder / (key + _SUFFIX))


def _prune(folder: Path, limit: int, newest: Path) -> None:
    """Removes abandoned parts, then of the finished files the longest unused but `newest`, until all fit the limit."""
    for part in folder.glob("*" + _PART):
        with suppress(OSError):  # another process may remove it first, here and below
            if part.stat().st_mtime < time.time() - _ABANDONED:
                part.unlink()
    found = []
    for path in folder.glob("*" + _SUFFIX):
        with suppress(OSError):
            status = path.stat()
            found.append((path == newest, status.st_mtime, path, status.st_size))
    total = sum(size for *_, size in found)
    for *_, path, size in sorted(found):  # the newest comes last, and fits by itself
        if total <= limit:
            return
        with suppress(OSError):
            path.unlink()
        total -= size
