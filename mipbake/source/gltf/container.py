"""The binary container of glTF 2.0 (specification, section 4.4): chunks taken apart and put together."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from mipbake.base.errors import InputError, OutputError

MAGIC = b"glTF"
_HEADER = struct.Struct("<4sII")  # magic, version, length of everything
_CHUNK = struct.Struct("<I4s")  # length, type
_JSON, _BIN = b"JSON", b"BIN\0"
_MOST = 0xFFFFFFFF


def unpacked(data: bytes, name: str) -> tuple[bytes, bytes | None, tuple[tuple[bytes, bytes], ...]]:
    """The chunks of a GLB; InputError, which calls it `name`, where it is cut short or its lengths contradict it.

    Returns:
        The JSON, without the padding; the BIN chunk, None where there is none; type and data of the chunks after those,
        which readers must pass over.
    """
    if len(data) < _HEADER.size:
        raise InputError(f"{name} is cut short after {len(data)} bytes: export or download it again")
    _, version, length = _HEADER.unpack_from(data)
    if version != 2:
        raise InputError(f"{name} is a GLB of version {version}: expected version 2, export it as glTF 2.0")
    if length > len(data):
        raise InputError(
            f"{name} is cut short: expected {length} bytes, found {len(data)}; export or download it again"
        )
    found, at = [], _HEADER.size
    while at < length:
        if at + _CHUNK.size > length:
            raise InputError(f"{name} ends within the header of a chunk at byte {at}: export or download it again")
        size, kind = _CHUNK.unpack_from(data, at)
        start = at + _CHUNK.size
        if start + size > length:
            raise InputError(
                f"{name} has a chunk at byte {at} that claims {size} bytes where {length - start} are left: it is "
                "broken, export or download it again"
            )
        found.append((kind, data[start : start + size]))
        at = start + size
    if not found or found[0][0] != _JSON:
        raise InputError(f"{name} is a GLB whose first chunk is not JSON: it is broken, export or download it again")
    rest = found[1:]
    binary = rest.pop(0)[1] if rest and rest[0][0] == _BIN else None
    return found[0][1].rstrip(b" "), binary, tuple(rest)


def packed(text: bytes, binary: bytes, others: Sequence[tuple[bytes, bytes]] = ()) -> bytes:
    """A GLB: JSON padded with spaces, everything else with zeros, to multiples of 4 bytes; no BIN chunk for no bytes.
    OutputError where it would be longer than the container's 4 GiB."""
    chunks = [(_JSON, text + b" " * (-len(text) % 4))]
    if binary:
        chunks.append((_BIN, binary))
    body = []
    for kind, data in [*chunks, *others]:
        padding = bytes(-len(data) % 4)
        body += [_CHUNK.pack(min(len(data) + len(padding), _MOST), kind), data, padding]
    length = _HEADER.size + sum(map(len, body))
    if length > _MOST:
        raise OutputError(f"a GLB holds at most 4 GiB, this one would have {length} bytes: bake at a smaller size")
    return b"".join([_HEADER.pack(MAGIC, 2, length), *body])
