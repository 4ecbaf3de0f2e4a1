"""Where large arrays lie: in memory, or in temporary files whose pages come and go, so that a limit of memory is held.

A bake goes through its arrays in bands of rows: the maps that were read, the levels that are made, what files store of
them. All of them together may be larger than the memory of the machine. Within a limit, arrays that do not fit into a
share of it lie in temporary files that are mapped into memory. They are arrays like any others, so what is calculated
is the same, bit for bit. What a process holds is watched, and where it comes near the limit, all pages of these files
are let go of. A page comes back when it is next touched.

Files take room on the disk at once, so that a full disk is one sentence when an array is made, and not a broken process
when it is filled. They have no name, so nothing is left of them where a process is killed.

All of this is for Linux. On other systems a limit changes nothing, and arrays lie in memory.
"""

from __future__ import annotations

import errno
import math
import os
import re
import tempfile
import threading
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mipbake.base.errors import OutputError, UsageError

LEAST_SIZE = 1 << 24
"""Bytes of the smallest array that may lie in a file."""

AT_ONCE = 1 << 16
"""Texels whose temporaries are small, and hardly outnumbered by what a call costs."""

SHARE = 1 / 4
"""Share of a limit that arrays of LEAST_SIZE and more may take before files do; the rest is for what works on them, and
for pages of files."""

_NEAR = 2 / 3
"""Share of a limit from which pages are let go of."""

_LEAST_DEFAULT = 2 << 30
"""Bytes of the default limit, at least, so that small machines bake by every method."""

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_MOST = 1 << 62
"""Bytes beyond all machines, which still fit into a whole number of 64 bits."""

_CGROUP = Path("/sys/fs/cgroup/memory.max")


class Limit:
    """A limit of memory, and what lies within it.

    Args:
        size: bytes.
    """

    def __init__(self, size: int) -> None:
        from mipbake import _native

        self.size = size
        self._pages = _native.Pages(int(size * _NEAR))
        self._lock = threading.Lock()
        self._in_memory = 0

    def empty(self, shape: Sequence[int], dtype: np.dtype[Any]) -> NDArray[Any]:
        """See the function of this module."""
        size = math.prod(shape) * dtype.itemsize
        if size < LEAST_SIZE:
            return np.empty(shape, dtype)
        with self._lock:
            fits = self._in_memory + size <= self.size * SHARE
            self._in_memory += size if fits else 0
        if not fits:
            return self._mapped(shape, dtype, size)
        made = np.empty(shape, dtype)
        weakref.finalize(made, self._freed, size).atexit = False
        return made

    def _freed(self, size: int) -> None:
        with self._lock:
            self._in_memory -= size

    def _mapped(self, shape: Sequence[int], dtype: np.dtype[Any], size: int) -> NDArray[Any]:
        try:
            with tempfile.TemporaryFile(prefix="mipbake-") as file:
                os.posix_fallocate(file.fileno(), 0, size)
                pages = self._pages.map(file.fileno(), size)
        except OSError as error:
            raise OutputError(
                f"{told(size)} do not fit into the limit of memory ({told(self.size)}), and cannot lie in a temporary "
                f"file in {tempfile.gettempdir()} ({error.strerror or error}): make room there, name another folder in "
                "the environment variable TMPDIR, or raise the limit (--memory)"
            ) from error
        return np.asarray(_Mapped(pages, shape, dtype))


class _Mapped:
    """Bytes as the array that NumPy makes of them, which views of it then name as their base, in place of the bytes."""

    def __init__(self, pages: NDArray[np.uint8], shape: Sequence[int], dtype: np.dtype[Any]) -> None:
        self.pages = pages
        self.__array_interface__ = {
            "version": 3,
            "shape": tuple(shape),
            "typestr": dtype.str,
            "data": (pages.ctypes.data, False),
        }


_limit: Limit | None = None


@contextmanager
def limited(size: int | str | None) -> Iterator[None]:
    """Holds the process to so many bytes of memory while the block runs; None: to no limit.

    Args:
        size: bytes, or text that `parsed` reads.

    A limit within another one counts in its place. It holds for what comes from `empty`; what is smaller, and what
    libraries allocate themselves, is not touched by it. The limit is for the whole process, all threads.
    """
    global _limit  # noqa: PLW0603
    from mipbake import _native

    before = _limit
    wanted = parsed(size) if isinstance(size, str) else size
    _limit = Limit(wanted) if wanted is not None and _native.pages_supported() else None
    try:
        yield
    finally:
        _limit = before


def empty(shape: Sequence[int], dtype: DTypeLike = np.float32) -> NDArray[Any]:
    """An array of any values, C-contiguous, in memory or in a temporary file.

    Raises:
        OutputError: the file cannot be made.
    """
    return np.empty(shape, dtype) if _limit is None else _limit.empty(shape, np.dtype(dtype))


def copied(array: NDArray[Any]) -> NDArray[Any]:
    """A copy, C-contiguous, as `empty` makes arrays."""
    out = empty(array.shape, array.dtype)
    out[...] = array
    return out


def some_rows(image: NDArray[Any], texels: int = AT_ONCE) -> Iterator[slice]:
    """The rows of an image of at least two axes, about so many texels at a time, or a row."""
    step = max(1, texels // max(1, image.shape[1]))
    return (slice(start, min(len(image), start + step)) for start in range(0, len(image), step))


def check(needed: int, what: str) -> None:
    """UsageError where the limit is less than something needs.

    Args:
        needed: bytes that have to lie in memory, whatever lies in files.
        what: it is for, for the sentence.
    """
    if _limit is not None and _limit.size < needed:
        raise UsageError(
            f"{what} takes {told(needed)} of memory or more, and the limit is {told(_limit.size)}: raise the limit "
            "(--memory), or leave it out"
        )


def lacks(error: Exception) -> bool:
    """Whether an error says that memory, address space or threads ran out, whichever library it comes from."""
    if isinstance(error, OSError):
        return error.errno in (errno.ENOMEM, errno.EAGAIN)
    said = str(error).lower()
    return isinstance(error, MemoryError) or (
        isinstance(error, (ImportError, RuntimeError, ValueError, OverflowError))
        and any(words in said for words in _OUT_OF_MEMORY)
    )


_OUT_OF_MEMORY = (
    *("failed to map segment", "cannot allocate memory", "can't allocate memory", "bad_alloc", "out of memory"),
    *("can't start new thread", "resource temporarily unavailable"),
    *("maximum allowed size exceeded", "array is too big", "maximum supported dimension"),
)
"""What dynamic linkers, torch, C++, Python and NumPy say."""


def parsed(text: str) -> int:
    """Bytes of a size such as 4G, 1.5G, 800M or 2000000000; K, M, G and T are powers of 1,024.

    Raises:
        UsageError: it cannot be read, or is not above 0.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    size = float(found[1]) * _UNITS[found[2].upper()] if found else 0.0
    if not 1 <= size < _MOST:
        raise UsageError(f"the size of memory {text!r} cannot be read: expected a size such as 4G, 1.5G or 800M")
    return int(size)


def told(size: int) -> str:
    """A size for people, in the units of `parsed`."""
    unit = next((name for name in ("T", "G", "M", "K") if size >= _UNITS[name]), "")
    return f"{round(size / _UNITS[unit], 2):g} {unit}{'iB' if unit else 'bytes'}"


def installed() -> int | None:
    """Bytes of memory that the machine has, or that the container of the process may use; None where nothing tells."""
    try:
        size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows has no sysconf
        return None
    try:
        return min(size, int(_CGROUP.read_text(encoding="ascii")))
    except (OSError, ValueError):  # no such file, or "max"
        return size


def default() -> int | None:
    """A quarter of the memory that is installed, at least _LEAST_DEFAULT if there is so much; None for unknown."""
    size = installed()
    return None if size is None else max(size // 4, min(size, _LEAST_DEFAULT))
