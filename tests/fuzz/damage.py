"""Damaging a file: what a broken disk, a cut download, a careless program or an attacker does to it."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random

_NUMBERS = (0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_WORDS = (
    *("0", "-1", "1e999", "-1e999", "NaN", "Infinity", "1e-320", "99999999999999999999", "2147483648", "0.5"),
    *("null", "true", "[]", "{}", '""', '"x"', "[1, 2]", '{"a": 1}', '"../../x"', '"\\u0000"', '"' + "a" * 300 + '"'),
)
_TEXT = (".json", ".gltf", ".mtlx", ".obj", ".txt")
_PNG = b"\x89PNG\r\n\x1a\n"


def damaged(data: bytes, name: str, others: list[bytes], random: Random) -> bytes:
    """The file's bytes after one to six changes.

    Args:
        data: the whole file.
        name: its name; the suffix says what the changes may know of its structure.
        others: files of the same kind, to splice with.
        random: what decides.
    """
    suffix = Path(name).suffix
    if suffix == ".glb" and random.random() < 0.6:
        return _glb(data, lambda text: _changed(text, True, others, random))
    data = _changed(data, suffix in _TEXT, others, random)
    return _with_checksums(data) if data.startswith(_PNG) and random.random() < 0.8 else data


def _changed(data: bytes, is_text: bool, others: list[bytes], random: Random) -> bytes:
    for _ in range(random.choice((1, 1, 1, 2, 3, 6))):
        change = random.choice(_TEXT_CHANGES if is_text and random.random() < 0.8 else _BYTE_CHANGES)
        data = change(data, others, random)
    return data


def _place(data: bytes, random: Random) -> int:
    """An offset: every second one in the first 128 bytes, where headers are."""
    return random.randrange(max(1, min(len(data), 128) if random.random() < 0.5 else len(data)))


def _bit(data: bytes, _: list[bytes], random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + bytes([data[at] ^ (1 << random.randrange(8))]) + data[at + 1 :] if data else data


def _byte(data: bytes, _: list[bytes], random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + bytes([random.randrange(256)]) + data[at + 1 :]


def _number(data: bytes, _: list[bytes], random: Random) -> bytes:
    at, kind = _place(data, random), random.choice("<>") + random.choice("HIIQ")
    value = random.choice(_NUMBERS) & ((1 << 8 * struct.calcsize(kind)) - 1)
    return data[:at] + struct.pack(kind, value) + data[at + struct.calcsize(kind) :]


def _cut(data: bytes, _: list[bytes], random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _without(data: bytes, _: list[bytes], random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + data[at + random.choice((1, 2, 4, 16, 64)) :]


def _twice(data: bytes, _: list[bytes], random: Random) -> bytes:
    at, size = _place(data, random), random.choice((1, 4, 16, 256))
    return data[: at + size] + data[at:]


def _noise(data: bytes, _: list[bytes], random: Random) -> bytes:
    at, size = _place(data, random), random.choice((2, 8, 32))
    return data[:at] + random.randbytes(size) + data[at + size :]


def _spliced(data: bytes, others: list[bytes], random: Random) -> bytes:
    other = random.choice(others or [data])
    return data[: _place(data, random)] + other[_place(other, random) :]


def _word(data: bytes, _: list[bytes], random: Random) -> bytes:
    """Another value in the place of a number or of a quoted text."""
    found = list(re.finditer(rb'-?\d[\d.eE+-]*|"[^"\n]*"', data))
    if not found:
        return data
    match = random.choice(found)
    return data[: match.start()] + random.choice(_WORDS).encode() + data[match.end() :]


def _line(data: bytes, _: list[bytes], random: Random) -> bytes:
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    lines[at : at + 1] = random.choice(([], [lines[at]] * 2, [lines[at][::-1]]))
    return b"\n".join(lines)


def _exchanged(data: bytes, _: list[bytes], random: Random) -> bytes:
    """Two words change places."""
    found = list(re.finditer(rb"[\w.:-]+", data))
    if len(found) < 2:
        return data
    first, second = sorted(random.sample(found, 2), key=lambda match: match.start())
    between = data[first.end() : second.start()]
    return data[: first.start()] + second[0] + between + first[0] + data[second.end() :]


_Change = Callable[[bytes, "list[bytes]", Random], bytes]
_BYTE_CHANGES: tuple[_Change, ...] = (_bit, _byte, _number, _number, _cut, _without, _twice, _noise, _spliced)
_TEXT_CHANGES: tuple[_Change, ...] = (_word, _word, _word, _line, _exchanged)


def _with_checksums(data: bytes) -> bytes:
    """A PNG whose chunks have the checksums of what they hold now, so that what lies behind the check is reached."""
    out, at = bytearray(data), len(_PNG)
    while at + 12 <= len(out):
        end = at + 8 + int.from_bytes(out[at : at + 4], "big")
        if end + 4 > len(out):
            break
        out[end : end + 4] = zlib.crc32(out[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(out)


def _glb(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A GLB whose JSON is changed, with the lengths that fit."""
    if len(data) < 20:
        return change(data)
    size = int.from_bytes(data[12:16], "little")
    text = change(data[20 : 20 + size])
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    return data[:8] + struct.pack("<II4s", 20 + len(text) + len(rest), len(text), b"JSON") + text + rest
