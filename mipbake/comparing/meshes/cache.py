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
    """SHA-256, in hexadecimal, of named ingredients: arrays, numbers, strings, and tuples of those.

    Arrays of another dtype or shape are other content, and so is an integer beside a float of equal value.
    """
    digest = hashlib.sha256()
    for name, value in sorted(ingredients.items()):
        _feed(digest, name)
        _feed(digest, value)
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


def save(folder: Path, key: str, arrays: Mapping[str, NDArray[Any]], limit: int = LIMIT) -> str:
    """Saves arrays under a key, in place of what was there, and removes the oldest files beyond `limit` bytes.

    A reader sees the old file or the new one, whole. Nothing is raised where the folder cannot be written.

    Returns:
        "", or a sentence that says why nothing was saved.
    """
    size = sum(array.nbytes for array in arrays.values())
    if size > limit:
        return f"nothing is cached: {size:,} bytes are more than the {limit:,} that a cache may take"
    values: dict[str, Any] = dict(arrays)
    part: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(_PART, "", folder)
        part = Path(name)
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **values)
        part.replace(folder / (key + _SUFFIX))
        part = None
        _prune(folder, limit, folder / (key + _SUFFIX))
    except OSError as error:
        return f"nothing is cached: folder {folder} cannot be written ({error.strerror or error})"
    finally:
        if part is not None:
            with suppress(OSError):
                part.unlink()
    return ""


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
            found.append((path != newest, status.st_mtime, status.st_size, path))
    total = sum(size for _, _, size, _ in found)
    for removable, _, size, path in sorted(found, key=lambda each: each[1]):
        if total <= limit:
            return
        if removable:
            with suppress(OSError):
                path.unlink()
            total -= size


def _feed(digest: Any, value: object) -> None:
    """Adds a value so that no two different ones add the same bytes."""
    if isinstance(value, np.ndarray):
        digest.update(f"array {value.dtype.str} {value.shape}:".encode())
        digest.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8))
    elif isinstance(value, tuple):
        digest.update(f"tuple {len(value)}:".encode())
        for each in value:
            _feed(digest, each)
    elif isinstance(value, bool | int | float | str):
        text = f"{type(value).__name__} {value!r}"
        digest.update(f"{len(text.encode())} {text}:".encode())
    else:
        raise TypeError(f"no content key of {type(value).__name__}: expected arrays, numbers, strings and tuples")
