"""What is said of materials of a glTF document that cannot be baked, and that others are baked all the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import InputError

from .gltf_files import GltfFile, ktx2
from .input_files import write_image
from .test_gltf_materials import materials_of, simple

BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "texture": ({"normalTexture": {"index": 5}}, r"normalTexture of material 0 \(Simple\) names 5 of its 1 textures"),
    "no index": ({"normalTexture": {"scale": 1}}, "names None of its 1 textures"),
    "info": ({"normalTexture": 3}, r"normalTexture of material 0 \(Simple\) is 3, expected an object"),
    "pbr": ({"pbrMetallicRoughness": []}, r"is \[\], expected an object"),
    "roughness": ({"pbrMetallicRoughness": {"roughnessFactor": "1"}}, "roughnessFactor of .* is '1', expected a num"),
    "metallic": ({"pbrMetallicRoughness": {"metallicFactor": 2}}, "metallicFactor of .* is 2, expected .* from 0 to 1"),
    "colour": ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1]}}, "baseColorFactor .*, expected four numbers"),
    "scale": ({"normalTexture": {"index": 0, "scale": None}}, "scale of normalTexture .* is None, expected a number"),
    "alpha": ({"alphaMode": "HASH"}, "alphaMode of .* is 'HASH', expected OPAQUE, MASK or BLEND"),
    "transform": (
        {"normalTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": 2}}}},
        "texture coordinates of normalTexture of .* are not as glTF defines them",
    ),
    "huge offset": (
        {"normalTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0, 10**400]}}}},
        "texture coordinates of normalTexture of .* are not as glTF defines them",
    ),
    "strength": ({"extensions": {"KHR_materials_anisotropy": {"anisotropyStrength": 3}}}, "anisotropyStrength of "),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_materials_are_told_in_a_sentence(case: str, tmp_path: Path) -> None:
    members, message = BROKEN[case]
    with pytest.raises(InputError, match=message):
        materials_of(simple(**members), tmp_path)


def test_broken_textures_are_told_in_a_sentence(tmp_path: Path) -> None:
    for change, message in (
        ({"sampler": 4}, "names 4 of its 1 samplers"),
        ({"source": 4}, "names 4 of its 1 images"),
        ({"source": None}, "names None of its 1 images"),
    ):
        made = simple()
        made.json["textures"][0] |= change
        with pytest.raises(InputError, match=message):
            materials_of(made, tmp_path)
    made = simple()
    del made.json["textures"][0]["source"]
    with pytest.raises(InputError, match=r"texture 0 \(normalTexture of .*\) names no image"):
        materials_of(made, tmp_path)
    made = simple()
    made.json["samplers"][0]["wrapS"] = 1
    with pytest.raises(InputError, match="sampler 0 has the wrap mode 1, expected 33071, 33648 or 10497"):
        materials_of(made, tmp_path)


def test_materials_that_are_broken_leave_the_others(tmp_path: Path) -> None:
    """What several have in common is told once, with their names."""
    made = simple()
    made.json["textures"].append({"source": made.image(b"no image", "x")})
    for name in "abcdef":
        made.material(name, normalTexture={"index": 1})
    made.material("g", normalTexture={"index": 7})
    made.material("h", normalTexture={"index": 0}, pbrMetallicRoughness={"roughnessFactor": 0.5})
    found = materials_of(made, tmp_path)
    assert [bake.materials for bake in found.bakes] == [(0,), (8,)]
    image, index = found.errors
    assert "image 1 (x) is not of an image type" in image
    labels = ", ".join(f"material {i + 1} ({name})" for i, name in enumerate("abcd"))
    assert image.endswith(f"({labels} and 2 more cannot be baked)")
    assert "names 7 of its 2 textures" in index and index.endswith("(material 7 (g) cannot be baked)")


@pytest.mark.parametrize(("start", "mime"), [(ktx2(1)[:90], "ktx2"), (b"\0\0\0\x20ftypavif", "avif")])
def test_broken_images_of_every_kind_are_told(start: bytes, mime: str, tmp_path: Path) -> None:
    made = GltfFile()
    image = made.image(start, "k", f"image/{mime}")
    made.json["textures"].append({"extensions": {"KHR_texture_basisu": {"source": image}}})
    made.material("K", normalTexture={"index": 0})
    with pytest.raises(InputError, match=r"a.glb: image 0 \(k\) is not a readable image"):
        materials_of(made, tmp_path)


def test_pixels_that_are_cut_short_are_told_with_the_document_alone(tmp_path: Path) -> None:
    """The header is whole. The folder of extracted files is of no use to the reader: it will be gone."""
    jpeg = write_image(tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8))
    made = simple(jpeg.read_bytes()[:-1500])
    with pytest.raises(InputError, match=r"a.glb: image 1 \(b\) is not a readable image") as caught:
        materials_of(made, tmp_path)
    assert str(tmp_path / "images") not in str(caught.value)


def test_a_negative_scale_leaves_the_material_and_bakes_the_others(tmp_path: Path) -> None:
    made = simple(normalTexture={"index": 0, "scale": -0.5})
    made.material("Other", normalTexture={"index": 0})
    found = materials_of(made, tmp_path)
    assert [bake.materials for bake in found.bakes] == [(1,)]
    assert "scale of its normalTexture is -0.5, which inverts its bumps" in found.warnings[0]


def test_a_document_without_anything_to_bake_is_refused(tmp_path: Path) -> None:
    made = GltfFile()
    with pytest.raises(InputError, match=r"a.glb has no material to bake \(it has none at all\): expected one with"):
        materials_of(made, tmp_path)
    for name in "abcd":
        made.material(name)
    with pytest.raises(InputError, match=r"\(material 0 \(a\) has neither .*; and 1 more\)"):
        materials_of(made, tmp_path)
