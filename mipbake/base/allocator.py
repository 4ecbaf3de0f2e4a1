"""How the C library's allocator treats memory that is freed: a setting of the process, for those who own it."""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h


_MOST = 1 << 30
"""Bytes that are kept at most."""

_SHARE = 16
"""Part of a limit of memory that is kept at most."""


def keep_freed_memory(limit: int | None = None) -> None:
    """Tells glibc to keep what is freed: networks free tens of megabytes and soon ask for them again, page by page.

    Args:
        limit: bytes that the process is held to; None for no limit.

    For command lines, not for a library's functions. Nothing elsewhere; the allocators of other systems are left alone.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    for option in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD):
        mallopt(option, _MOST if limit is None else min(_MOST, limit // _SHARE))


def give_back_freed_memory() -> None:
    """Has glibc give what is freed back to the system.

    Threads that come and go each leave memory to the allocator, which it keeps for other threads. A process that bakes
    one set after the other would hold more and more of it.
    """
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (OSError, AttributeError, TypeError):
        return
