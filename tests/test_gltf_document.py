"""Reading glTF documents: the same bytes wherever they lie, and a sentence for whatever is broken."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mipbake.base.errors import InputError
from mipbake.source.gltf.document import read_document, view_bytes
from mipbake.source.gltf.images import PNG, stored_image

from .gltf_files import GltfFile, glb, many_materials, png

KINDS = ("glb", "external", "embedded")


@pytest.mark.parametrize("kind", KINDS)
def test_images_and_buffers_are_found_wherever_they_lie(kind: str, tmp_path: Path) -> None:
    made = many_materials()
    document = read_document(made.write(tmp_path / "many", kind))
    assert document.buffers == (made.data,)
    assert document.json["materials"] == made.json["materials"]
    for index, image in enumerate(made.json["images"]):
        view = made.json["bufferViews"][image["bufferView"]]
        expected = made.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        assert stored_image(document, index) == (expected, PNG)


def test_content_and_not_the_name_tells_the_container(tmp_path: Path) -> None:
    binary = many_materials().write(tmp_path / "a", "glb").rename(tmp_path / "a.gltf")
    text = many_materials().write(tmp_path / "b", "embedded").rename(tmp_path / "b.glb")
    assert read_document(binary).json["materials"] == read_document(text).json["materials"]
    text.write_bytes(b"\xef\xbb\xbf\n" + text.read_bytes())
    assert read_document(text).buffers == read_document(binary).buffers


def test_padding_and_further_chunks_of_a_glb(tmp_path: Path) -> None:
    made = GltfFile()
    made.view(b"12345")
    document = {**made.json, "buffers": [{"byteLength": 5}]}
    path = tmp_path / "a.glb"
    path.write_bytes(glb(document, b"12345", (b"XTRA", b"more")) + b"behind the end")
    found = read_document(path)
    assert found.buffers == (b"12345",)
    assert found.chunks == ((b"XTRA", b"more"),)


def test_names_in_uris_are_percent_decoded_and_taken_literally_where_that_fails(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    for name in ("maps/ä b.png", "100%25.png", "up.png"):
        (tmp_path / name).write_bytes(png(name))
    uris = {"maps/%C3%A4%20b.png": "maps/ä b.png", "100%25.png": "100%25.png", "maps/../up.png": "up.png"}
    document = {"asset": {"version": "2.0"}, "images": [{"uri": uri} for uri in uris]}
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document))
    found = read_document(path)
    assert [stored_image(found, i)[0] for i in range(3)] == [png(name) for name in uris.values()]


def test_data_uris_without_base64_and_with_encoded_padding(tmp_path: Path) -> None:
    buffers = [
        {"byteLength": 2, "uri": "data:,%00a"},
        {"byteLength": 1, "uri": "data:application/gltf-buffer;base64,Yg%3D%3D"},
    ]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "buffers": buffers}))
    assert read_document(path).buffers == (b"\0a", b"b")


def test_a_placeholder_has_no_bytes_and_is_refused_only_when_they_are_asked_for(tmp_path: Path) -> None:
    made = GltfFile()
    made.json["buffers"] = [{"byteLength": 100}]
    made.image(png("a"), "a")
    made.json["bufferViews"].append({"buffer": 1, "byteLength": 50})
    document = read_document(made.write(tmp_path / "a"))
    assert document.buffers[1] is None
    with pytest.raises(InputError, match=r"a.glb: image 9 lies in buffer 1, for which the file has no bytes"):
        view_bytes(document, 1, "image 9")


def _json(**members: Any) -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, **members}).encode()


def _chunk_of(size: int) -> bytes:
    data = bytearray(glb({"asset": {"version": "2.0"}}, b"1234"))
    struct.pack_into("<I", data, 12, size)
    return bytes(data)


BUFFER = [{"byteLength": 4, "uri": "data:;base64,MTIzNA=="}]
BROKEN: dict[str, tuple[bytes, str]] = {
    "text": (b"hello", "is not a glTF file: expected JSON, or a GLB"),
    "nothing": (b"", "is empty"),
    "short": (b"glTF", "is cut short after 4 bytes"),
    "first version": (struct.pack("<4sII", b"glTF", 1, 12), "a GLB of version 1"),
    "cut": (glb({"asset": {"version": "2.0"}}, b"1234")[:-3], "is cut short: expected 64 bytes, found 61"),
    "chunk beyond the end": (_chunk_of(1000), "a chunk at byte 12 that claims 1000 bytes where 44 are left"),
    "chunk header": (struct.pack("<4sII", b"glTF", 2, 16) + b"1234", "ends within the header of a chunk at byte 12"),
    "no JSON": (struct.pack("<4sIII4s", b"glTF", 2, 20, 0, b"BIN\0"), "whose first chunk is not JSON"),
    "JSON": (b'{"asset": ', "holds JSON that is damaged"),
    "deep": (b'{"a":' + b"[" * 100000, "holds JSON that is damaged"),
    "nested": (_json(extras=json.loads("[" * 300 + "]" * 300)), "with more than 200 objects nested in each other"),
    "no asset": (b"{}", "is JSON without asset.version"),
    "glTF 1": (b'{"asset": {"version": "1.0"}}', "is of glTF version 1.0: expected 2.0"),
    "no array": (_json(images={}), "its images are not an array of objects"),
    "no length": (_json(buffers=[{}]), "byteLength of buffer 0 is None"),
    "missing file": (_json(buffers=[{"byteLength": 4, "uri": "not%20here.bin"}]), "is the file 'not here.bin', which"),
    "uri": (_json(buffers=[{"byteLength": 4, "uri": 3}]), "the URI of buffer 0 is 3, expected a text"),
    "network": (_json(buffers=[{"byteLength": 4, "uri": "https://a.b/c"}]), "lies at 'https://a.b/c': expected a path"),
    "absolute": (_json(buffers=[{"byteLength": 4, "uri": "/etc/c"}]), "lies at '/etc/c': expected a path relative"),
    "above": (_json(buffers=[{"byteLength": 4, "uri": "../c"}]), "lies at '../c': expected a path relative to the"),
    "above, encoded": (_json(buffers=[{"byteLength": 4, "uri": "%2e%2e%2Fc"}]), "within its folder"),
    "base64": (_json(buffers=[{"byteLength": 4, "uri": "data:;base64,MTI@NA=="}]), "whose base64 is damaged"),
    "short buffer": (_json(buffers=[{**BUFFER[0], "byteLength": 5}]), "has 4 bytes where 5 are declared"),
    "view beyond": (
        _json(buffers=BUFFER, bufferViews=[{"buffer": 0, "byteOffset": 2, "byteLength": 3}]),
        "bufferView 0 runs to byte 5 of buffer 0, which has 4",
    ),
    "view of none": (_json(bufferViews=[{"buffer": 0, "byteLength": 3}]), "bufferView 0 names 0 of its 0 buffers"),
    "view length": (_json(buffers=BUFFER, bufferViews=[{"buffer": 0}]), "byteLength of bufferView 0 is None"),
    "view offset": (
        _json(buffers=BUFFER, bufferViews=[{"buffer": 0, "byteLength": 1, "byteOffset": -1}]),
        "byteOffset of bufferView 0 is -1",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_are_reported_in_a_sentence(case: str, tmp_path: Path) -> None:
    data, message = BROKEN[case]
    path = tmp_path / "a.gltf"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_document(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing.glb does not exist"):
        read_document(tmp_path / "nothing.glb")
    with pytest.raises(InputError, match="is a folder"):
        read_document(tmp_path)


IMAGES: dict[str, tuple[Callable[[GltfFile], object], str]] = {
    "no PNG": (lambda made: made.image(b"123456", "b"), "that glTF knows .declared as image/png"),
    "nowhere": (lambda made: made.json["images"].append({}), "image 0 has neither a bufferView nor a URI"),
    "view": (lambda made: made.json["images"].append({"bufferView": 7}), "image 0 names 7 of its 0 bufferViews"),
    "missing": (lambda made: made.json["images"].append({"uri": "sub/a%20b.png"}), r"image 0 \(sub/a%20b.png\) of "),
    "none": (lambda made: None, "a texture names 0 of its 0 images"),
}


@pytest.mark.parametrize("case", IMAGES)
def test_images_that_cannot_be_read(case: str, tmp_path: Path) -> None:
    change, message = IMAGES[case]
    made = GltfFile()
    change(made)
    with pytest.raises(InputError, match=message):
        stored_image(read_document(made.write(tmp_path / "a")), 0)


@pytest.mark.parametrize("uri", ["maps\\a.png", "maps%5Ca.png"])
def test_backslashes_lead_into_folders_unless_a_file_is_called_so(uri: str, tmp_path: Path) -> None:
    made = GltfFile()
    made.json["images"].append({"uri": uri})
    document = read_document(made.write(tmp_path / "a"))
    (tmp_path / "maps").mkdir()
    for place, kind in ((tmp_path / "maps" / "a.png", "inside"), (tmp_path / "maps\\a.png", "literal")):
        place.write_bytes(png(kind))
        assert stored_image(document, 0)[0] == png(kind)


@pytest.mark.parametrize("source", [99, -1, None, True])
@pytest.mark.parametrize("alone", [False, True])
def test_a_basisu_source_that_is_no_image_is_refused(tmp_path: Path, source: object, alone: bool) -> None:
    file = GltfFile()
    texture = file.json["textures"][file.texture(file.image(png("colour", 8), "colour"))]
    texture["extensions"] = {"KHR_texture_basisu": {"source": source}}
    if alone:
        del texture["source"]
    file.uses("KHR_texture_basisu")
    with pytest.raises(InputError, match=r"KHR_texture_basisu of texture 0 names .* of its 1 images"):
        read_document(file.write(tmp_path / "a.glb"))
