"""Written glTF documents: bytes, indices and numbers of others that stay where images give way to baked maps."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest

from mipbake.stack.gltf.write import rewritten

from .gltf_files import (
    check_structure,
    image_of,
    png,
    split,
    view_of,
)
from .gltf_results import baked, infos, opened, results_of, two_textures


def test_compressed_geometry_keeps_its_bytes_and_placeholders_their_buffers(tmp_path: Path) -> None:
    """EXT_meshopt_compression has a buffer and an offset of its own, behind images that vanish; buffers are joined."""
    made = two_textures(png("normal"), png("mr"))
    compressed = bytes(range(100, 200))
    at = len(made.data) + -len(made.data) % 16
    made.data += bytes(at - len(made.data)) + compressed
    second = bytes(range(50))
    uri = "data:;base64," + base64.b64encode(second).decode()
    fallback = {"EXT_meshopt_compression": {"fallback": True}}
    made.json["buffers"] = [{"byteLength": 960, "extensions": fallback}, {"byteLength": 50, "uri": uri}]
    meshopt = {"buffer": 0, "byteOffset": at, "byteLength": 100, "byteStride": 16, "mode": "ATTRIBUTES", "count": 60}
    extension = {"extensions": {"EXT_meshopt_compression": meshopt}}
    made.json["bufferViews"].append({"buffer": 1, "byteLength": 960, "byteStride": 16, **extension})
    made.json["bufferViews"].append({"buffer": 2, "byteOffset": 8, "byteLength": 12})
    made.uses("EXT_meshopt_compression")
    document, bakes = opened(made, tmp_path)
    written, binary = split(rewritten(document, results_of(bakes, False), {}))
    view = written["bufferViews"][2]
    moved = view["extensions"]["EXT_meshopt_compression"]
    assert (view["buffer"], view["byteLength"], "byteOffset" in view) == (1, 960, False)
    assert written["buffers"][1] == {"byteLength": 960, "extensions": fallback}
    assert len(written["buffers"]) == 2
    assert moved["buffer"] == 0 and moved["byteOffset"] % 16 == 0 and moved["byteOffset"] < at
    assert binary[moved["byteOffset"] :][:100] == compressed
    assert {key: moved[key] for key in meshopt if key != "byteOffset"} == {
        key: value for key, value in meshopt.items() if key != "byteOffset"
    }
    assert view_of(written, binary, 3) == second[8:20]
    assert png("normal") not in binary and png("mr") not in binary


def test_bytes_that_something_else_lies_in_are_kept(tmp_path: Path) -> None:
    """A view that overlaps the image's, a view that two images share, a view that an extension names."""
    for case in ("overlap", "two images", "extension"):
        made = two_textures(png("normal"), png("mr"))
        if case == "overlap":
            made.json["bufferViews"].append({"buffer": 0, "byteOffset": 40, "byteLength": 60})
        elif case == "two images":
            made.json["images"].append({"bufferView": 0, "mimeType": "image/png"})
            made.texture(2)
            made.material("Other", emissiveTexture={"index": 2})
        else:
            made.json["extensions"] = {"EXT_example": {"thing": {"bufferView": 0}}}
            made.uses("EXT_example")
        document, bakes = opened(made, tmp_path)
        results = results_of(bakes, False)
        written, binary = check_structure(rewritten(document, results, {}))
        shown = infos(written["materials"][0])
        assert image_of(written, binary, shown["normalTexture"]["index"]) == results[0].maps["normalTexture"]
        if case == "overlap":
            assert view_of(written, binary, 2) == made.data[40:100]
        else:
            assert view_of(written, binary, 0) == png("normal")
        assert png("mr") not in binary


@pytest.mark.parametrize("extension", [{"specularImages": [[0, 1]]}, {"textureProperties": {"_MainTex": 0}}])
def test_numbers_of_unknown_extensions_keep_their_textures(extension: dict[str, Any], tmp_path: Path) -> None:
    made = two_textures(png("normal"), png("mr"))
    made.json["extensions"] = {"EXT_example": extension}
    made.uses("EXT_example")
    written, binary, results = baked(made, tmp_path)
    assert view_of(written, binary, written["images"][0]["bufferView"]) == png("normal")
    shown = infos(written["materials"][0])["normalTexture"]["index"]
    assert image_of(written, binary, shown) == results[0].maps["normalTexture"]
    assert written["extensions"] == made.json["extensions"]


def test_transforms_name_no_textures(tmp_path: Path) -> None:
    made = two_textures(png("normal"), png("mr"))
    transform = {"KHR_texture_transform": {"offset": [0, 1], "scale": [1, 1], "texCoord": 1}}
    for holder in (made.json["materials"][0], made.json["materials"][0]["pbrMetallicRoughness"]):
        for key in [key for key in holder if key.endswith("Texture")]:
            holder[key]["extensions"] = transform
    made.uses("KHR_texture_transform")
    written, _, _ = baked(made, tmp_path)
    assert [len(written[key]) for key in ("textures", "images", "bufferViews")] == [2, 2, 2]


def test_images_that_gave_way_to_one_map_show_it(tmp_path: Path) -> None:
    """Two images of equal bytes are baked once: both indices stay, and the bytes are there once."""
    made = two_textures(png("normal"), png("mr"))
    made.texture(made.image(png("normal"), "again"))
    made.material("Again", normalTexture={"index": 2}, pbrMetallicRoughness={"metallicRoughnessTexture": {"index": 1}})
    written, binary, results = baked(made, tmp_path)
    assert [result.bake.materials for result in results] == [(0, 1)]
    normal = results[0].maps["normalTexture"]
    assert image_of(written, binary, 0) == image_of(written, binary, 2) == normal
    assert [image["name"] for image in written["images"]] == ["n", "mr", "again"]
    assert view_of(written, binary, written["images"][2]["bufferView"]) == normal
    assert binary.count(normal) == 1 and png("normal") not in binary


def test_one_image_that_becomes_several(tmp_path: Path) -> None:
    """Two materials with one normal map and different roughness: the first map takes the image's place."""
    made = two_textures(png("normal"), png("mr"))
    rough = {"metallicRoughnessTexture": {"index": 1}, "roughnessFactor": 0.5}
    made.material("Other", normalTexture={"index": 0}, pbrMetallicRoughness=rough)
    written, binary, results = baked(made, tmp_path)
    assert len(results) == 2
    for index, result in enumerate(results):
        for slot, info in infos(written["materials"][index]).items():
            assert image_of(written, binary, info["index"]) == result.maps[slot]
    assert [len(written[key]) for key in ("images", "textures")] == [4, 4]
    assert [texture["sampler"] for texture in written["textures"]] == [0] * 4


def test_other_formats_of_a_replaced_texture_go(tmp_path: Path) -> None:
    made = two_textures(png("normal"), png("mr"))
    webp = b"RIFF1234WEBP" + bytes(range(40))
    source = made.image(webp, "w", "image/webp")
    made.json["textures"][0]["extensions"] = {"EXT_texture_webp": {"source": source}}
    made.uses("EXT_texture_webp")
    written, binary, results = baked(made, tmp_path)
    assert written["textures"][0] == {"sampler": 0, "extensions": {"KHR_texture_basisu": {"source": 0}}}
    assert written["extensionsUsed"] == ["KHR_texture_basisu"]
    assert webp not in binary
    assert image_of(written, binary, 0) == results[0].maps["normalTexture"]


def test_what_is_empty_is_as_if_it_were_not_there(tmp_path: Path) -> None:
    made = two_textures(png("normal"), png("mr"))
    made.json["materials"][0]["normalTexture"] = {}
    made.json["textures"][1]["extensions"] = None
    written, binary, results = baked(made, tmp_path)
    for slot, info in infos(written["materials"][0]).items():
        if slot in results[0].maps:
            assert image_of(written, binary, info["index"]) == results[0].maps[slot]
    assert written["materials"][0]["normalTexture"].keys() == {"index"}


def test_what_lies_right_behind_an_image_that_vanishes_moves(tmp_path: Path) -> None:
    images = (data + bytes(-len(data) % 16) for data in (png("normal"), png("mr")))  # readers pass over what follows
    made = two_textures(*images)
    view = made.view(b"what follows")
    written, binary, _ = baked(made, tmp_path)
    assert view_of(written, binary, view) == b"what follows" == binary[:12]
