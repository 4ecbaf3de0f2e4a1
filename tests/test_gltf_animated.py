"""Animations of glTF documents that set what a bake takes in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.materials import read_materials

from .gltf_files import GltfFile, png
from .gltf_results import two_textures


def warned(made: GltfFile, folder: Path, *pointers: object) -> list[str]:
    """What is said of the animations that set what the pointers name."""
    channels = [
        {"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}}
        for pointer in pointers
    ]
    made.json["animations"] = [{"channels": channels, "samplers": [{"input": 0, "output": 1}]}]
    found = read_materials(read_document(made.write(folder / "a")), folder)
    return [warning for bake in found.bakes for warning in bake.warnings]


@pytest.mark.parametrize(
    ("member", "value"),
    [
        ("pbrMetallicRoughness/roughnessFactor", "0.5"),
        ("pbrMetallicRoughness/metallicFactor", "1"),
        ("normalTexture/scale", "2"),
        ("extensions/KHR_materials_anisotropy/anisotropyStrength", "0.25"),
        ("extensions/KHR_materials_anisotropy/anisotropyRotation", "0"),
        ("alphaCutoff", "0.4"),
    ],
)
def test_animations_of_what_is_baked_in_are_told(member: str, value: str, tmp_path: Path) -> None:
    made = two_textures(png("normal"), png("mr"))
    made.texture(made.image(png("leaves", channels=4), "leaves"))
    material = made.json["materials"][0]
    material["normalTexture"]["scale"] = 2
    material["pbrMetallicRoughness"] |= {
        "roughnessFactor": 0.5,
        "baseColorTexture": {"index": 2},
        "baseColorFactor": [1, 1, 1, 0.8],
    }
    material |= {"alphaMode": "MASK", "alphaCutoff": 0.4}
    material["extensions"] = {"KHR_materials_anisotropy": {"anisotropyStrength": 0.25}}
    (warning,) = warned(made, tmp_path, f"/materials/0/{member}")
    assert f"material 0 (M): an animation sets {member}, which is baked in as {value}, its value at rest" in warning


@pytest.mark.parametrize(
    "pointer",
    [
        "/materials/0/emissiveFactor",
        "/materials/0/pbrMetallicRoughness/baseColorFactor",
        "/materials/1/pbrMetallicRoughness/roughnessFactor",
        "/materials/0/extensions/KHR_materials_anisotropy/anisotropyStrength",
        "/nodes/0/translation",
        "/materials/x",
        "",
        None,
        3,
    ],
)
def test_other_animations_are_not(pointer: Any, tmp_path: Path) -> None:
    assert warned(two_textures(png("normal"), png("mr")), tmp_path, pointer) == []
