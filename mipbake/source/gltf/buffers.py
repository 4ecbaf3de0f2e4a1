"""Makes the buffers of a document into the one buffer of a GLB, without the bytes that nobody needs any more."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from mipbake.source.gltf.uses import Json, buffer_uses

_STEP = 16
"""Bytes are taken away in multiples of this, so that what lies behind them keeps its alignment."""

ALIGNMENT = 4

Interval = tuple[int, int]


@dataclass(frozen=True)
class _Moved:
    """Where a buffer lies in the new one, and what has been cut out of it: (start, end), in ascending order."""

    base: int
    cuts: tuple[Interval, ...]

    def moved(self, offset: int) -> int:
        return self.base + offset - sum(end - start for start, end in self.cuts if end <= offset)


class Binary:
    """The bytes of a GLB's BIN chunk, as they grow."""

    def __init__(self) -> None:
        self._data = bytearray()

    def __len__(self) -> int:
        return len(self._data)

    def add(self, data: bytes, alignment: int = ALIGNMENT) -> int:
        """Appends data and returns its offset."""
        self._data += bytes(-len(self._data) % alignment)
        self._data += data
        return len(self._data) - len(data)

    def taken(self) -> bytes:
        """All bytes."""
        return bytes(self._data)


def merged(document: Json, buffers: Sequence[bytes | None], dropped: Collection[int]) -> Binary:
    """One buffer in place of all that have bytes; every use in `document` is moved along.

    The new buffer is the first, as a GLB wants it; placeholders without bytes follow in their order.

    Args:
        document: its `buffers`, and every object with `buffer` and `byteOffset`, are changed.
        buffers: bytes of each, None for placeholders.
        dropped: bufferViews whose bytes nobody needs. What something else lies in as well is kept.
    """
    uses = buffer_uses(document)
    dead = {id(document["bufferViews"][index]) for index in dropped}
    binary, parts, places = Binary(), {}, {}
    for index, data in enumerate(buffers):
        if data is None:
            continue
        here = [use for use in uses if use["buffer"] == index]
        freed = [_range(use, len(data)) for use in here if id(use) in dead]
        cuts = tuple(
            (start, start + (end - start) // _STEP * _STEP)
            for start, end in _without(freed, [_range(use, len(data)) for use in here if id(use) not in dead])
        )
        kept, at = [], 0
        for start, end in cuts:
            kept.append(data[at:start])
            at = end
        kept.append(data[at:])
        parts[index] = _Moved(binary.add(b"".join(kept), _STEP), cuts)
    described = document.get("buffers", [])
    # Its name and what else it says; not that it is what an extension decompresses, which no longer is true of all.
    first = {key: value for key, value in described[min(parts)].items() if key in ("name", "extras")} if parts else {}
    placeholders = [index for index, data in enumerate(buffers) if data is None]
    places = {index: 1 + i for i, index in enumerate(placeholders)}
    for use in uses:
        index = use["buffer"]
        if index in parts:
            offset = parts[index].moved(use.get("byteOffset", 0))
            use["buffer"] = 0
            if offset or "byteOffset" in use:
                use["byteOffset"] = offset
        elif index in places:
            use["buffer"] = places[index]
    document["buffers"] = [first, *(described[index] for index in placeholders)]
    return binary


def _range(use: Json, size: int) -> Interval:
    """The bytes that an object lies in: to the end of the buffer where it does not tell."""
    start = use.get("byteOffset", 0)
    length = use.get("byteLength")
    return start, start + length if isinstance(length, int) else size


def _without(freed: Sequence[Interval], needed: Sequence[Interval]) -> list[Interval]:
    """What of the freed intervals no needed one touches, joined and in ascending order."""
    found: list[Interval] = []
    for start, end in sorted(freed):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((start, end))
    for low, high in needed:
        found = [
            piece
            for start, end in found
            for piece in ((start, min(end, low)), (max(start, high), end))
            if piece[0] < piece[1]
        ]
    return found
