"""Machines that run the core as WebAssembly, and how arrays get into their memory and out of it.

A machine has its own memory and one thread, so calls from several threads take several machines. A machine that
stopped at a fault is never used again.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from wasmtime import Config, Engine, Linker, Module, Store, Trap, WasiConfig, WasmtimeError

from mipbake.base.errors import UsageError

CORE = Path(__file__).with_name("core.wasm")

_KEPT = 1 << 26
"""Bytes of memory up to which a machine is kept for other calls: it never gives memory back."""

_ALL = (1 << 32) - 1
_TOO_LARGE = (
    "this texture set does not fit into 4 GiB of memory, which is all that mipbake's core has as WebAssembly: take "
    "smaller images, or install mipbake where it has a compiled core (docs/installing.md)"
)


@dataclass(frozen=True, eq=False)
class Out:
    """An array that a call fills. `read`: the call reads its values, too."""

    array: NDArray[Any]
    read: bool = False


@dataclass(frozen=True, eq=False)
class Strided:
    """An array of any strides: its address, and the steps of its first `axes` in elements, 0 where one repeats."""

    array: NDArray[Any]
    axes: int


class Machine:
    """The core, and a memory of its own."""

    def __init__(self) -> None:
        linker, module = _compiled()
        self._store = Store(linker.engine)
        self._store.set_wasi(WasiConfig())
        self._exports = linker.instantiate(self._store, module).exports(self._store)
        self._memory: Any = self._exports["memory"]
        self._taken: list[int] = []
        self._outs: list[tuple[int, Out]] = []
        self.call("_initialize")

    @property
    def size(self) -> int:
        """Bytes of its memory."""
        return int(self._memory.data_len(self._store))

    def call(self, name: str, *arguments: int) -> int:
        """What a function gives.

        Raises:
            ValueError: what the core found wrong, in its words.
            UsageError: memory ran out.
        """
        functions: Any = self._exports
        try:
            return int(functions[name](self._store, *arguments) or 0)
        except (Trap, WasmtimeError) as trap:
            fault = self.text(functions["last_fault"](self._store))
            if fault == "std::bad_alloc" or (not fault and self.size > _ALL // 2):
                raise UsageError(_TOO_LARGE) from None
            raise (ValueError(fault) if fault else RuntimeError(f"the core stopped: {trap}")) from None

    def text(self, address: int) -> str:
        """A text that ends with a byte of 0."""
        here = self._memory.get_buffer_ptr(self._store, 0, address & _ALL)
        return ctypes.string_at(ctypes.addressof(here)).decode()

    def placed(self, *given: Any) -> int:
        """The address of words that stand for numbers, arrays, None, and lists of them."""
        return self._place(np.fromiter(self._words(given), np.int64))

    def collect(self) -> None:
        """Fills the arrays of every Out."""
        for address, out in self._outs:
            out.array[...] = self._view(address, out.array)

    def release(self) -> None:
        """Gives back the memory of everything that was placed."""
        for address in self._taken:
            self.call("give", address)
        self._taken, self._outs = [], []

    def _words(self, given: Any) -> Iterator[int]:
        for each in given:
            if each is None:
                yield 0
            elif isinstance(each, float):
                yield struct.unpack("<q", struct.pack("<d", each))[0]
            elif isinstance(each, np.ndarray):
                yield self._place(each)
            elif isinstance(each, Out):
                address = self._place(each.array) if each.read else self._take(each.array.nbytes)
                self._outs.append((address, each))
                yield address
            elif isinstance(each, Strided):
                yield from self._strided(each.array, each.axes)
            elif isinstance(each, (list, tuple)):
                yield from self._words(each)
            else:
                yield int(each)

    def _strided(self, array: NDArray[Any], axes: int) -> Iterator[int]:
        """What repeats is copied once."""
        repeats = [size == 1 or step == 0 for size, step in zip(array.shape, array.strides, strict=True)][:axes]
        once = array[tuple(slice(1 if each else None) for each in repeats)]
        yield self._place(once)
        for axis, each in enumerate(repeats):
            yield 0 if each else int(np.prod(once.shape[axis + 1 :]))

    def _place(self, array: NDArray[Any]) -> int:
        address = self._take(array.nbytes)
        self._view(address, array)[...] = array
        return address

    def _take(self, size: int) -> int:
        address = self.call("take", size) & _ALL if size < _ALL else 0
        if not address:
            raise UsageError(_TOO_LARGE)
        self._taken.append(address)
        return address

    def _view(self, address: int, like: NDArray[Any]) -> NDArray[Any]:
        return self._bytes(address, like.nbytes).view(like.dtype).reshape(like.shape)

    def _bytes(self, address: int, size: int) -> NDArray[np.uint8]:
        bytes_here: Any = self._memory.get_buffer_ptr(self._store, size, address)
        return np.frombuffer(bytes_here, np.uint8)


def run(name: str, *given: Any) -> None:
    """Calls a function of csrc/wasm/native.cpp with words, and fills the arrays of every Out."""
    try:
        machine = _idle.pop()
    except IndexError:
        machine = Machine()
    machine.call(name, machine.placed(*given))
    machine.collect()
    machine.release()
    if machine.size <= _KEPT:
        _idle.append(machine)


_idle: list[Machine] = []


@cache
def _compiled() -> tuple[Linker, Module]:
    """The core as machine code, which wasmtime keeps in the user's cache: compiling takes about a second."""
    config = Config()
    try:
        config.cache = True
        engine = Engine(config)
    except WasmtimeError:  # no such folder can be written
        engine = Engine()
    linker = Linker(engine)
    linker.define_wasi()
    return linker, Module.from_file(engine, str(CORE))
