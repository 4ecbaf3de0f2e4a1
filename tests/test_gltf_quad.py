"""The square that shows a baked material: its geometry, its material, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.source.gltf.document import read_document
from mipbake.stack.gltf.quad import SLOTS, QuadOptions, standalone

from .gltf_files import check_structure, image_of, ktx2, png

MAPS = {slot: ktx2(i, slot in ("baseColorTexture", "emissiveTexture")) for i, slot in enumerate(SLOTS)}


def material_of(maps: dict[str, bytes], **options: Any) -> dict[str, Any]:
    document, _ = check_structure(standalone("a", maps, QuadOptions(**options)))
    found: dict[str, Any] = document["materials"][0]
    return found


def test_every_map_is_shown_in_its_slot(tmp_path: Path) -> None:
    data = standalone("brick", MAPS, QuadOptions(occlusion=True, wrap=("clamp", "wrap")), {"method": "auto"})
    document, binary = check_structure(data)
    material = document["materials"][0]
    slots = {**material, **material["pbrMetallicRoughness"], **material["extensions"]["KHR_materials_anisotropy"]}
    for slot, data_ in MAPS.items():
        assert image_of(document, binary, slots[slot]["index"]) == data_
    assert material["occlusionTexture"] == slots["metallicRoughnessTexture"]
    assert slots["anisotropyStrength"] == 1
    assert document["samplers"] == [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 10497}]
    assert document["asset"]["extras"]["mipbake"] == {"method": "auto"}
    assert document["extensionsRequired"] == ["KHR_texture_basisu"]
    path = tmp_path / "a.glb"
    path.write_bytes(data)
    assert read_document(path).json == document


def test_the_square_lies_as_images_do(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(standalone("a", {}))
    mesh = read_mesh(path)
    assert mesh.positions[:, :2] == pytest.approx(np.stack([mesh.uv[:, 0] - 0.5, 0.5 - mesh.uv[:, 1]], -1))
    assert np.array_equal(mesh.tangents, np.tile([1, 0, 0, 1], (len(mesh.tangents), 1)))
    a, b, c = mesh.positions[mesh.triangles].swapaxes(0, 1)
    faces = np.cross(b - a, c - a)
    assert faces == pytest.approx(np.tile([0, 0, 1.0], (2, 1)))
    assert np.array_equal(mesh.normals, np.tile([0, 0, 1], (4, 1)))


def test_factors_stand_for_maps_that_are_not_there() -> None:
    options: dict[str, Any] = {"roughness": 0.25, "metallic": 0.5, "base_color": (0.1, 0.2, 0.3, 1.0)}
    alone = material_of({}, **options)["pbrMetallicRoughness"]
    assert alone == {"baseColorFactor": [0.1, 0.2, 0.3, 1.0], "metallicFactor": 0.5, "roughnessFactor": 0.25}
    packed = material_of({"metallicRoughnessTexture": ktx2(1)}, **options)["pbrMetallicRoughness"]
    assert (packed["metallicFactor"], packed["roughnessFactor"]) == (1, 1)


def test_alpha_and_sides() -> None:
    assert not {"alphaMode", "alphaCutoff", "doubleSided"} & set(material_of({}))
    masked = material_of({}, alpha_mode="MASK", alpha_cutoff=0.3, double_sided=True)
    assert (masked["alphaMode"], masked["alphaCutoff"], masked["doubleSided"]) == ("MASK", 0.3, True)
    assert "alphaCutoff" not in material_of({}, alpha_mode="BLEND")


def test_what_cannot_be_shown_is_refused() -> None:
    with pytest.raises(UsageError, match="unknown slot 'roughness' of a: expected some of baseColorTexture"):
        standalone("a", {"roughness": ktx2(1)})
    with pytest.raises(UsageError, match="the map normalTexture of a is not a KTX 2 file"):
        standalone("a", {"normalTexture": png("a")})
    with pytest.raises(UsageError, match="a has no metallicRoughnessTexture map whose red channel"):
        standalone("a", {}, QuadOptions(occlusion=True))
    with pytest.raises(UsageError, match="wrap is"):
        QuadOptions(wrap=("wrap", "mirror"))
    with pytest.raises(UsageError, match="alpha_mode is 'HASH'"):
        QuadOptions(alpha_mode="HASH")
