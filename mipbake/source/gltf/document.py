"""A glTF document: its JSON as parsed, and the bytes that it refers to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake.base import disk, json_text
from mipbake.base.errors import InputError
from mipbake.base.messages import one_line
from mipbake.source.gltf import container, uris

Json = dict[str, Any]

_ARRAYS: Mapping[str, tuple[type, str]] = {
    **dict.fromkeys(("buffers", "bufferViews", "images", "textures", "samplers", "materials"), (dict, "objects")),
    **dict.fromkeys(("extensionsUsed", "extensionsRequired"), (str, "names")),
}
"""Top-level arrays to what they hold."""

_DEPTH = 200
"""Objects and arrays in each other: far more than a document needs, and few enough to be copied and written."""


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF 2.0 file.

    Args:
        path: where it was read from; messages name it.
        json: as parsed, with everything that is not known here.
        buffers: the bytes of each buffer, as many as it declares. None where the file brings none: a placeholder for
            what an extension decompresses.
        chunks: type and data of further chunks of a GLB.
    """

    path: Path
    json: Json
    buffers: tuple[bytes | None, ...]
    chunks: tuple[tuple[bytes, bytes], ...] = ()

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Document({str(self.path)!r}, {len(self.all('materials'))} materials)"

    def all(self, kind: str) -> list[Json]:
        """The objects of a top-level array ("images"), empty where there is none."""
        found: list[Json] = self.json.get(kind, [])
        return found

    @property
    def about(self) -> Json | None:
        """What mipbake wrote into it about how it was made; None in files of others."""
        extras = self.json["asset"].get("extras")
        about = extras.get("mipbake") if isinstance(extras, dict) else None
        return about if isinstance(about, dict) else None

    def one(self, kind: str, index: object, where: str) -> Json:
        """An object of a top-level array; InputError, which says `where` it is named, where there is none."""
        objects = self.all(kind)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(objects):
            raise InputError(
                f"{self.path}: {where} names {index!r} of its {len(objects)} {kind}: the file is broken, check it with "
                "the glTF validator and export it again"
            )
        return objects[index]


def read_document(path: Path) -> Document:
    """Reads a .gltf or .glb file with its buffers; its content decides which of the two it is. InputError where it is
    not glTF 2, is damaged or cut short, or refers to what is not there."""
    if not disk.exists(path):
        raise InputError(f"{path} does not exist: expected a .gltf or .glb file")
    data = disk.read_bytes(path)
    if not data:
        raise InputError(f"{path} is empty (0 bytes): export or download it again")
    if data.startswith(container.MAGIC):
        text, binary, others = container.unpacked(data, str(path))
    elif data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        text, binary, others = data, None, ()
    else:
        raise InputError(f"{path} is not a glTF file: expected JSON, or a GLB that begins with glTF")
    parsed = _parsed(path, text)
    buffers = tuple(_buffer(path, i, b, binary) for i, b in enumerate(parsed.get("buffers", [])))
    document = Document(path, parsed, buffers, others)
    _check_references(document)
    return document


def view_bytes(document: Document, index: object, where: str) -> bytes:
    """The bytes of a bufferView; InputError, which says `where` it is named, where it has none."""
    view = document.one("bufferViews", index, where)
    data = document.buffers[view["buffer"]]
    if data is None:
        raise InputError(
            f"{document.path}: {where} lies in buffer {view['buffer']}, for which the file has no bytes: it is "
            "broken, export it again"
        )
    start = view.get("byteOffset", 0)
    return data[start : start + view["byteLength"]]


def number(value: object, where: str, path: Path, least: float, most: float) -> float:
    """A number of the JSON; InputError where it is not a number or lies outside least..most."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
        raise InputError(
            f"{path}: {where} is {value!r}, expected a number from {least:g} to {most:g}: correct it or export again"
        )
    return float(value)


def member(parent: Mapping[str, Any], key: str, where: str, path: Path) -> Json:
    """An object within an object of the JSON, empty where there is none; InputError where it is something else."""
    found = parent.get(key, {})
    if not isinstance(found, dict):
        raise InputError(f"{path}: {key} of {where} is {found!r}, expected an object: the file is broken, export again")
    return found


def extensions_in(holder: Json) -> Json:
    """The extensions of an object of the JSON, empty where it has none or something else in their place."""
    found = holder.get("extensions")
    return found if isinstance(found, dict) else {}


def _parsed(path: Path, text: bytes) -> Json:
    try:
        parsed = json_text.parsed(text)
    except ValueError as error:
        raise InputError(
            f"{path} holds JSON that is damaged ({one_line(str(error))}): export or download it again"
        ) from error
    if not isinstance(parsed, dict):
        raise InputError(f"{path} holds JSON that is not an object: expected a glTF 2.0 document")
    if _is_deeper(parsed, _DEPTH):
        raise InputError(
            f"{path} holds JSON with more than {_DEPTH} objects nested in each other: expected fewer, export it flat"
        )
    asset = parsed.get("asset")
    if not isinstance(asset, dict) or asset.get("version") is None:
        raise InputError(f"{path} is JSON without asset.version: expected a glTF 2.0 document")
    version, least = str(asset["version"]), str(asset.get("minVersion", "2.0"))
    if not re.fullmatch(r"2\.\d+", version) or least != "2.0":
        needed = f", and needs {least}" if least != "2.0" else ""
        raise InputError(f"{path} is of glTF version {version}{needed}: expected 2.0, export it as glTF 2.0")
    for kind, (held, expected) in _ARRAYS.items():
        found = parsed.get(kind, [])
        if not isinstance(found, list) or not all(isinstance(each, held) for each in found):
            raise InputError(
                f"{path}: its {kind} are not an array of {expected}: the file is broken, check it with the glTF "
                "validator and export it again"
            )
    return parsed


def _is_deeper(node: Any, depth: int) -> bool:
    """Whether objects and arrays lie more than so many levels deep."""
    layer = [node]
    for _ in range(depth):
        layer = [
            inner
            for each in layer
            for inner in (each.values() if isinstance(each, dict) else each)
            if isinstance(inner, (dict, list))
        ]
    return bool(layer)


def _size(path: Path, holder: Json, key: str, where: str, default: int | None = None) -> int:
    """A number of bytes in the JSON."""
    value = holder.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise InputError(f"{path}: {key} of {where} is {value!r}, expected a whole number: export it again")
    return value


def _buffer(path: Path, index: int, buffer: Json, binary: bytes | None) -> bytes | None:
    uri, what = buffer.get("uri"), f"buffer {index}"
    length = _size(path, buffer, "byteLength", what)
    if uri is None and (index != 0 or binary is None):
        return None
    if uri is not None and not isinstance(uri, str):
        raise InputError(f"{path}: the URI of {what} is {uri!r}, expected a text: export it again")
    data = binary if uri is None else uris.read_uri(uri, path, what)
    if data is None or len(data) < length:
        raise InputError(
            f"{what} of {path} has {len(data or b'')} bytes where {length} are declared: it is cut short or belongs to "
            "another file, export or download it again"
        )
    return data[:length]


def _check_references(document: Document) -> None:
    """InputError where a bufferView, an image or a texture refers to what is not there."""
    for index, view in enumerate(document.all("bufferViews")):
        where = f"bufferView {index}"
        size = document.one("buffers", view.get("buffer"), where)["byteLength"]
        end = _size(document.path, view, "byteOffset", where, 0) + _size(document.path, view, "byteLength", where)
        if end > size:
            raise InputError(
                f"{document.path}: {where} runs to byte {end} of buffer {view['buffer']}, which has {size}: the file "
                "is broken, export or download it again"
            )
    for index, image in enumerate(document.all("images")):
        if "bufferView" in image:
            document.one("bufferViews", image["bufferView"], f"image {index}")
    for index, texture in enumerate(document.all("textures")):
        where = f"texture {index}"
        holders = {where: texture, **{f"{name} of {where}": e for name, e in extensions_in(texture).items()}}
        for named, holder in holders.items():
            if isinstance(holder, dict) and "source" in holder:
                document.one("images", holder["source"], named)
