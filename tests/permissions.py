"""File permissions that bind the tests, whoever runs them."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator

import pytest

_VERSION = 0x20080522
_DAC_OVERRIDE, _DAC_READ_SEARCH = 1, 2


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


class _Sets(ctypes.Structure):
    _fields_ = (("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32))


@pytest.fixture
def bound_by_permissions() -> Iterator[None]:
    """Takes the power to read everything from root, for this thread and what it starts; skips where that fails."""
    if os.name == "nt":
        pytest.skip("Windows has other permissions")
    if os.geteuid() != 0:
        yield
        return
    if sys.platform != "linux":
        pytest.skip("root cannot give up its power here")
    libc = ctypes.CDLL(None, use_errno=True)
    header, before = _Header(_VERSION, 0), (_Sets * 2)()
    if libc.capget(ctypes.byref(header), before) != 0:
        pytest.skip("root cannot give up its power here")
    less = (_Sets * 2).from_buffer_copy(before)
    less[0].effective &= ~(1 << _DAC_OVERRIDE | 1 << _DAC_READ_SEARCH)
    assert libc.capset(ctypes.byref(header), less) == 0
    try:
        yield
    finally:
        assert libc.capset(ctypes.byref(header), before) == 0
