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

_EXTENSIONS = ("extensionsUsed", "extensionsRequired")
_DEPTH = 200
"""Objects and arrays in each other: far more than a document needs, and few enough to be copied and written."""

_ARRAYS = ("buffers", "bufferViews", "images", "textures", "samplers", "materials")


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
    """Reads a .gltf or .glb file, which of them its content tells, with its buffers.

    Raises:
        InputError: it is not glTF 2, or it is damaged or cut short; a buffer is missing, or too short for what lies in
            it; a texture names an image that is not there.
    """
    data = _read(path)
    if data.startswith(container.MAGIC):
        chunks = container.unpacked(data, str(path))
    elif data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        chunks = container.Chunks(data, None)
    else:
        raise InputError(f"{path} is not a glTF file: expected JSON, or a GLB that begins with glTF")
    parsed = _parsed(path, chunks.text)
    _check_version(path, parsed)
    _check_arrays(path, parsed)
    buffers = tuple(_buffer(path, i, b, chunks.binary) for i, b in enumerate(parsed.get("buffers", [])))
    document = Document(path, parsed, buffers, chunks.others)
    for index, view in enumerate(document.all("bufferViews")):
        _check_view(document, index, view)
    for index, image in enumerate(document.all("images")):
        if "bufferView" in image:
            document.one("bufferViews", image["bufferView"], f"image {index}")
    for index, texture in enumerate(document.all("textures")):
        _check_sources(document, index, texture)
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


def _read(path: Path) -> bytes:
    if not disk.exists(path):
        raise InputError(f"{path} does not exist: expected a .gltf or .glb file")
    data = disk.read_bytes(path)
    if not data:
        raise InputError(f"{path} is empty (0 bytes): export or download it again")
    return data


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


def _check_version(path: Path, parsed: Json) -> None:
    asset = parsed.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if version is None:
        raise InputError(f"{path} is JSON without asset.version: expected a glTF 2.0 document")
    least = asset.get("minVersion", "2.0") if isinstance(asset, dict) else "2.0"
    if not re.fullmatch(r"2\.\d+", str(version)) or str(least) != "2.0":
        needed = f", and needs {least}" if str(least) != "2.0" else ""
        raise InputError(f"{path} is of glTF version {version}{needed}: expected 2.0, export it as glTF 2.0")


def _check_arrays(path: Path, parsed: Json) -> None:
    for kind in (*_ARRAYS, *_EXTENSIONS):
        found = parsed.get(kind, [])
        held, expected = (dict, "objects") if kind in _ARRAYS else (str, "names")
        if not isinstance(found, list) or not all(isinstance(each, held) for each in found):
            raise InputError(
                f"{path}: its {kind} are not an array of {expected}: the file is broken, check it with the glTF "
                "validator and export it again"
            )


def _buffer(path: Path, index: int, buffer: Json, binary: bytes | None) -> bytes | None:
    uri, length = buffer.get("uri"), buffer.get("byteLength")
    what = f"buffer {index}"
    if not isinstance(length, int) or isinstance(length, bool) or length < 0:
        raise InputError(f"{path}: {what} has the byteLength {length!r}, expected a whole number: export it again")
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


def _check_sources(document: Document, index: int, texture: Json) -> None:
    """InputError where a texture, or an extension of it such as KHR_texture_basisu, names an image that does not
    exist."""
    extensions = texture.get("extensions")
    named = {f"{name} of texture {index}": e for name, e in extensions.items()} if isinstance(extensions, dict) else {}
    for where, holder in {f"texture {index}": texture, **named}.items():
        if isinstance(holder, dict) and "source" in holder:
            document.one("images", holder["source"], where)


def _check_view(document: Document, index: int, view: Json) -> None:
    where = f"bufferView {index}"
    buffer = document.one("buffers", view.get("buffer"), where)
    start, length = view.get("byteOffset", 0), view.get("byteLength")
    for key, value in (("byteOffset", start), ("byteLength", length)):
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise InputError(
                f"{document.path}: {key} of {where} is {value!r}, expected a whole number: export it again"
            )
    if start + length > buffer["byteLength"]:
        raise InputError(
            f"{document.path}: {where} runs to byte {start + length} of buffer {view['buffer']}, which has "
            f"{buffer['byteLength']}: the file is broken, export or download it again"
        )
