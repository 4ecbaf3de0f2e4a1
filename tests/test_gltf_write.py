"""glTF documents with baked textures: what is replaced, and that nothing else is."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from mipbake.base.errors import InputError
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.materials import read_materials
from mipbake.stack.gltf.quad import standalone
from mipbake.stack.gltf.write import rewritten

from .gltf_files import (
    BASE,
    BRUSHED,
    COMBED,
    DRACO,
    FENCE,
    FENCE_NORMAL,
    LEATHER,
    LEAVES,
    NORMAL,
    ORM,
    RED_LEATHER,
    SET1_MR,
    SET1_NORMAL,
    SHIFTED,
    TWO_SETS,
    check_structure,
    glb,
    image_of,
    ktx2,
    many_materials,
    png,
    split,
    view_of,
)
from .gltf_results import PROVENANCE, baked, infos, opened, results_of, two_textures

KINDS = ("glb", "external", "embedded")


@pytest.mark.parametrize(("kind", "anisotropic"), [("glb", True), ("external", False), ("embedded", True)])
def test_baked_maps_are_shown_and_everything_else_stays(kind: str, anisotropic: bool, tmp_path: Path) -> None:
    made = many_materials()
    document, bakes = opened(made, tmp_path, kind)
    before = copy.deepcopy(document.json)
    results = results_of(bakes, anisotropic)
    written, binary = check_structure(rewritten(document, results, PROVENANCE))
    assert document.json == before
    of = {index: result for result in results for index in result.bake.materials}
    for index, (old, new) in enumerate(zip(made.json["materials"], written["materials"], strict=True)):
        maps = of[index].maps if index in of else {}
        for slot, info in infos(new).items():
            shown = image_of(written, binary, info["index"])
            if slot in maps:
                assert shown == maps[slot], (index, slot)
                continue
            texture = infos(old)[slot]["index"]
            follows = slot == "occlusionTexture" and index in of
            view = made.json["bufferViews"][made.json["images"][made.json["textures"][texture]["source"]]["bufferView"]]
            stays = made.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
            assert shown == (maps["metallicRoughnessTexture"] if follows else stays), (index, slot)
        assert set(maps) <= set(infos(new))
        if not maps:
            assert new == old
    # What is no texture is what it was, number for number.
    for key in ("scene", "scenes", "nodes", "meshes", "accessors", "samplers", "extras"):
        assert written[key] == before[key]
    for index in range(len(made.json["accessors"])):
        view = made.json["accessors"][index]["bufferView"]
        place = made.json["bufferViews"][view]
        assert view_of(written, binary, view) == made.data[place["byteOffset"] :][: place["byteLength"]]
        assert written["bufferViews"][view]["target"] == place["target"]
    draco = written["meshes"][-1]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]
    assert view_of(written, binary, draco["bufferView"]) == DRACO
    assert written["asset"]["extras"] == {"author": "nobody", "mipbake": PROVENANCE}
    assert written["asset"]["generator"] == "by hand"
    assert written["extensionsRequired"] == ["KHR_texture_basisu"]
    assert len(written["buffers"]) == 1 and written["buffers"][0]["name"] == "everything"


def test_factors_that_are_in_the_maps_become_1(tmp_path: Path) -> None:
    made = many_materials()
    written, _, _ = baked(made, tmp_path)
    old, new = made.json["materials"], written["materials"]
    assert list(new[BRUSHED]["extensions"]) == ["KHR_materials_clearcoat"]
    assert "extensions" not in new[COMBED]
    assert "KHR_materials_anisotropy" not in written["extensionsUsed"]
    assert new[LEATHER]["pbrMetallicRoughness"]["roughnessFactor"] == 1
    assert "metallicFactor" not in new[LEATHER]["pbrMetallicRoughness"]
    assert new[SHIFTED]["pbrMetallicRoughness"]["metallicFactor"] == 1
    assert new[LEATHER]["normalTexture"]["scale"] == 1
    assert new[LEATHER]["occlusionTexture"]["strength"] == 0.7
    assert new[RED_LEATHER]["pbrMetallicRoughness"]["baseColorFactor"] == [1.0, 0.1, 0.1, 1.0]
    assert {k: new[FENCE]["pbrMetallicRoughness"][k] for k in ("roughnessFactor", "metallicFactor")} == {
        "roughnessFactor": 1,
        "metallicFactor": 1,
    }
    for key in ("alphaMode", "alphaCutoff", "doubleSided"):
        assert new[FENCE][key] == old[FENCE][key]
    assert new[LEATHER]["extensions"] == old[LEATHER]["extensions"]
    assert new[LEATHER]["emissiveFactor"] == old[LEATHER]["emissiveFactor"]


def test_texture_coordinates_and_transforms_stay_and_go_to_new_slots(tmp_path: Path) -> None:
    made = many_materials()
    written, _, _ = baked(made, tmp_path, anisotropic=True)
    for index in (TWO_SETS, SHIFTED, FENCE, BRUSHED, COMBED):
        old, new = made.json["materials"][index], written["materials"][index]
        for slot, info in infos(old).items():
            kept = {key: value for key, value in infos(new)[slot].items() if key not in ("index", "scale")}
            assert kept == {key: value for key, value in info.items() if key not in ("index", "scale")}
        anisotropy = new["extensions"]["KHR_materials_anisotropy"]
        assert (anisotropy["anisotropyStrength"], anisotropy["anisotropyRotation"]) == (1, 0)
        mapping = {
            key: value for key, value in infos(old)["normalTexture"].items() if key in ("texCoord", "extensions")
        }
        for slot in ("anisotropyTexture", "metallicRoughnessTexture"):
            assert mapping.items() <= infos(new)[slot].items()
    assert written["materials"][BRUSHED]["extensions"]["KHR_materials_clearcoat"] == {"clearcoatFactor": 1}
    assert "KHR_materials_anisotropy" in written["extensionsUsed"]
    assert "KHR_materials_anisotropy" not in written["extensionsRequired"]


def test_indices_are_stable_and_unused_images_lose_their_bytes(tmp_path: Path) -> None:
    made = many_materials()
    written, binary, results = baked(made, tmp_path)
    shown = {data for result in results for data in result.maps.values()}
    images = made.json["images"]
    for index, image in enumerate(images):
        new = written["images"][index]
        assert (new["name"], new["bufferView"]) == (image["name"], image["bufferView"])
        place = made.json["bufferViews"][image["bufferView"]]
        data = made.data[place["byteOffset"] :][: place["byteLength"]]
        gone = index in (FENCE_NORMAL, SET1_NORMAL, SET1_MR)
        assert (data in binary) != gone
        assert (view_of(written, binary, new["bufferView"]) in shown) == gone
        assert new["mimeType"] == ("image/ktx2" if gone else "image/png")
    for index, texture in enumerate(made.json["textures"]):
        assert written["textures"][index].get("sampler") == texture.get("sampler")
    for index in (BASE, ORM, NORMAL, LEAVES):  # others show these still
        kept = index != LEAVES
        assert (written["textures"][index] == made.json["textures"][index]) == kept
    assert "source" not in written["textures"][LEAVES]
    # The two materials of one bake show the same textures, and these are there once.
    assert (
        infos(written["materials"][LEATHER]).items()
        >= {
            slot: info for slot, info in infos(written["materials"][RED_LEATHER]).items() if slot != "occlusionTexture"
        }.items()
    )
    assert sum(image["mimeType"] == "image/ktx2" for image in written["images"]) == len(shown)
    assert all(binary.count(data) == 1 for data in shown)


def test_without_results_the_document_is_the_same(tmp_path: Path) -> None:
    made = many_materials()
    for kind in KINDS:
        document, _ = opened(made, tmp_path, kind)
        data = rewritten(document, [], PROVENANCE)
        written, binary = check_structure(data)
        assert written["asset"].pop("extras")["mipbake"] == PROVENANCE
        expected = {**made.json, "asset": {k: v for k, v in made.json["asset"].items() if k != "extras"}}
        if kind == "glb":
            assert binary.startswith(made.data)
            assert written.pop("buffers")[0]["byteLength"] == len(made.data)
            assert written == expected
        for index in range(len(made.json["images"])):
            assert image_of(written, binary, index) == view_of(
                made.json, made.data, made.json["images"][index]["bufferView"]
            )


def test_further_chunks_addresses_and_odd_extras_stay(tmp_path: Path) -> None:
    made = two_textures(png("normal"), png("mr"))
    made.json["images"].append({"uri": "https://example.org/a.png"})
    made.json["asset"]["extras"] = "mine"
    path = made.write(tmp_path / "a")
    document, binary = split(path.read_bytes())
    path.write_bytes(glb(document, binary, (b"XTRA", b"12345678")))
    document_ = read_document(path)
    assert document_.chunks == ((b"XTRA", b"12345678"),)
    images = tmp_path / "images"
    images.mkdir()
    data = rewritten(document_, results_of(read_materials(document_, images).bakes, False), PROVENANCE)
    written, _ = check_structure(data)
    assert data.endswith(b"\x08\0\0\0XTRA12345678")
    assert written["images"][2] == {"uri": "https://example.org/a.png"}
    assert written["asset"]["extras"] == {"extras": "mine", "mipbake": PROVENANCE}


def test_a_document_whose_images_alone_are_files(tmp_path: Path) -> None:
    """No buffer before, one after; an image that stays is taken in."""
    for name in ("n", "e"):
        (tmp_path / f"{name}.png").write_bytes(png(f"normal {name}"))
    document = {
        "asset": {"version": "2.0"},
        "images": [{"uri": "n.png"}, {"uri": "e.png"}],
        "textures": [{"source": 0}, {"source": 1}],
        "materials": [{"normalTexture": {"index": 0}, "emissiveTexture": {"index": 1}}],
    }
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document))
    (tmp_path / "images").mkdir()
    read = read_document(path)
    results = results_of(read_materials(read, tmp_path / "images").bakes, False)
    written, binary = check_structure(rewritten(read, results, {}))
    assert image_of(written, binary, 0) == results[0].maps["normalTexture"]
    assert image_of(written, binary, 1) == png("normal e")
    assert len(written["buffers"]) == 1
    (tmp_path / "e.png").unlink()
    with pytest.raises(InputError, match=r"image 1 \(e.png\) of .* which does not exist beside it"):
        rewritten(read, results, {})


def test_an_occlusion_of_its_own_stays_beside_one_that_follows(tmp_path: Path) -> None:
    """Two materials of one bake: one has its occlusion in the packed image, the other in an image of its own."""
    made = two_textures(png("normal"), png("mr"))
    made.texture(made.image(png("ao"), "ao"))
    made.json["materials"].append(copy.deepcopy(made.json["materials"][0]))
    for material, texture in zip(made.json["materials"], (1, 2), strict=True):
        material["occlusionTexture"] = {"index": texture}
    written, binary, results = baked(made, tmp_path)
    assert [result.bake.materials for result in results] == [(0, 1)]
    shown = [image_of(written, binary, material["occlusionTexture"]["index"]) for material in written["materials"]]
    assert shown == [results[0].maps["metallicRoughnessTexture"], png("ao")]


SLOTS = "baseColorTexture", "metallicRoughnessTexture", "normalTexture", "anisotropyTexture", "emissiveTexture"
MAPS = {slot: ktx2(i, slot in ("baseColorTexture", "emissiveTexture")) for i, slot in enumerate(SLOTS)}


def test_every_map_is_shown_in_its_slot(tmp_path: Path) -> None:
    data = standalone("brick", MAPS, {"method": "auto"}, ("clamp", "wrap"), True, {"alphaMode": "BLEND"})
    document, binary = check_structure(data)
    material = document["materials"][0]
    slots = {**material, **material["pbrMetallicRoughness"], **material["extensions"]["KHR_materials_anisotropy"]}
    for slot, data_ in MAPS.items():
        assert image_of(document, binary, slots[slot]["index"]) == data_
    assert material["occlusionTexture"] == slots["metallicRoughnessTexture"]
    assert (slots["anisotropyStrength"], slots["metallicFactor"], slots["roughnessFactor"]) == (1, 1, 1)
    assert material["alphaMode"] == "BLEND"
    assert document["samplers"] == [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 10497}]
    assert document["asset"]["extras"]["mipbake"] == {"method": "auto"}
    assert document["extensionsRequired"] == ["KHR_texture_basisu"]
    path = tmp_path / "a.glb"
    path.write_bytes(data)
    assert read_document(path).json == document


def test_the_square_lies_as_images_do(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(standalone("a", {}, {}))
    mesh = read_mesh(path)
    assert mesh.positions[:, :2] == pytest.approx(np.stack([mesh.uv[:, 0] - 0.5, 0.5 - mesh.uv[:, 1]], -1))
    assert np.array_equal(mesh.tangents, np.tile([1, 0, 0, 1], (len(mesh.tangents), 1)))
    a, b, c = mesh.positions[mesh.triangles].swapaxes(0, 1)
    faces = np.cross(b - a, c - a)
    assert faces == pytest.approx(np.tile([0, 0, 1.0], (2, 1)))
    assert np.array_equal(mesh.normals, np.tile([0, 0, 1], (4, 1)))
