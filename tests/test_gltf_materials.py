"""What is baked of a glTF document: which materials together, from which channels, with which factors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import InputError
from mipbake.base.srgb import srgb_to_linear
from mipbake.source.gltf.document import read_document
from mipbake.source.gltf.materials import GltfBake, GltfMaterials, read_materials
from mipbake.source.images.read import read_image
from mipbake.source.loading import load

from .gltf_files import (
    BASE,
    BRUSHED,
    COMBED,
    DIRECTIONS,
    FENCE,
    FENCE_NORMAL,
    FOREIGN,
    FOREIGN_NORMAL,
    LEATHER,
    LEAVES,
    NORMAL,
    ORM,
    RED_LEATHER,
    SET1_MR,
    SET1_NORMAL,
    SHIFTED,
    TWO_SETS,
    WORN_LEATHER,
    GltfFile,
    many_materials,
    png,
)
from .gltf_results import two_textures
from .input_files import write_image

KINDS = ("glb", "external", "embedded")
STEMS = [image["name"].replace(" ", "_") for image in many_materials().json["images"]]
APART = {"index": 0, "texCoord": 1}
UNUSED = {"opacity": None, "occlusion": None, "height": None, "emissive": None}
PACKED = {
    "base_color": f"{STEMS[BASE]}.png:RGB",
    "normal": f"{STEMS[NORMAL]}.png:RGB",
    "roughness": f"{STEMS[ORM]}.png:G",
    "metallic": f"{STEMS[ORM]}.png:B",
    "occlusion": f"{STEMS[ORM]}.png:R",
}


def materials_of(made: GltfFile, folder: Path, kind: str = "glb") -> GltfMaterials:
    images = folder / "images"
    images.mkdir(exist_ok=True)
    return read_materials(read_document(made.write(folder / "a", kind)), images)


def only(made: GltfFile, folder: Path) -> GltfBake:
    found = materials_of(made, folder)
    assert len(found.bakes) == 1
    return found.bakes[0]


def simple(base: bytes | None = None, size: int = 8, **members: Any) -> GltfFile:
    """One material with a normal map (texture 0) and, with `base`, a base colour (texture 1)."""
    made = GltfFile()
    made.texture(made.image(png("normal", size), "n"))
    members = {"normalTexture": {"index": 0}, **members}
    if base is not None:
        made.texture(made.image(base, "b"))
        members["pbrMetallicRoughness"] = {
            "baseColorTexture": {"index": 1},
            **members.get("pbrMetallicRoughness", {}),
        }
    made.material("Simple", **members)
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_every_material_with_something_to_bake_is_in_one_bake(kind: str, tmp_path: Path) -> None:
    found = materials_of(many_materials(), tmp_path, kind)
    bakes = {bake.name: bake for bake in found.bakes}
    assert {name: bake.materials for name, bake in bakes.items()} == {
        "Leather": (LEATHER, RED_LEATHER),
        "leather_2": (WORN_LEATHER,),
        "Fence": (FENCE,),
        "Two_sets": (TWO_SETS,),
        "Shifted": (SHIFTED,),
        "Foreign": (FOREIGN,),
        "Brushed": (BRUSHED,),
        "material_13": (COMBED,),
    }
    assert {k: v for k, v in bakes["Leather"].options.maps.items() if v is not None} == PACKED
    assert bakes["Leather"].options.maps == bakes["Shifted"].options.maps == bakes["leather_2"].options.maps
    assert bakes["Leather"].options.factors == {"normal": 0.5, "roughness": 0.8}
    assert bakes["leather_2"].options.factors == {"normal": 0.5, "roughness": 0.5}
    assert bakes["Shifted"].options.factors == {"normal": 0.5, "roughness": 0.8, "metallic": 0.25}
    assert bakes["Fence"].options.maps == UNUSED | {
        "base_color": f"{STEMS[LEAVES]}.png:RGB",
        "opacity": f"{STEMS[LEAVES]}.png:A",
        "normal": f"{STEMS[FENCE_NORMAL]}.png:RGB",
        "roughness": 0.6,
        "metallic": 0.0,
    }
    assert bakes["Fence"].options.alpha_cutoff == pytest.approx(0.5)
    assert bakes["Foreign"].options.maps == UNUSED | {
        "base_color": 1.0,
        "normal": f"{STEMS[FOREIGN_NORMAL]}.png:RGB",
        "roughness": 1.0,
        "metallic": 1.0,
    }
    for name, bake in bakes.items():
        assert bake.options.name == name
        assert (bake.options.colour_space, bake.options.normal_convention) == ("sRGB", "opengl")
        assert bake.slots[-3:] == ("metallicRoughnessTexture", "normalTexture", "anisotropyTexture")
        assert ("baseColorTexture" in bake.slots) == (name in ("Leather", "leather_2", "Fence", "Shifted"))
    assert [w.split(":")[0].split(" is")[0] for w in found.warnings] == ["material 6 (Apart)"]
    left = [n.split(")")[0] for n in found.notes if n.startswith("material")]
    assert left == ["material 7 (Glow", "material 9 (Unlit", "material 10 (Glossy", "material 11 (Plain"]
    (plain,) = (n for n in found.notes if n.startswith("not prefiltered"))
    assert "emissiveTexture of material 7 (Glow)" in plain
    assert any("share these textures, which are baked once" in note for note in bakes["Leather"].notes)
    assert any("normal 0.5, roughness 0.8" in note for note in bakes["Leather"].notes)
    assert not any(bake.warnings for bake in found.bakes)


def test_base_colour_that_lies_elsewhere_is_its_mean(tmp_path: Path) -> None:
    made = many_materials()
    bake = next(bake for bake in materials_of(made, tmp_path).bakes if bake.name == "Two_sets")
    assert [bake.options.maps[role] for role in ("normal", "roughness", "metallic")] == [
        f"{STEMS[SET1_NORMAL]}.png:RGB",
        f"{STEMS[SET1_MR]}.png:G",
        f"{STEMS[SET1_MR]}.png:B",
    ]
    assert any("is left as it is" in note for note in bake.notes)
    pixels = load(bake.files, bake.options).maps["base_color"].pixels
    base = read_image(tmp_path / "images" / f"{STEMS[BASE]}.png").pixels / 255.0
    assert pixels == pytest.approx(np.broadcast_to(srgb_to_linear(base).mean((0, 1)), pixels.shape), abs=2e-5)


def test_factors_of_the_base_colour_stand_for_a_texture_that_is_not_there(tmp_path: Path) -> None:
    made = simple(pbrMetallicRoughness={"baseColorFactor": [0.2, 0.4, 0.6, 1.0]})
    made.material("Other", normalTexture={"index": 0}, pbrMetallicRoughness={"baseColorFactor": [0.4, 0.6, 0.0, 0.5]})
    bake = only(made, tmp_path)
    assert bake.materials == (0, 1)
    pixels = load(bake.files, bake.options).maps["base_color"].pixels
    assert pixels[0, 0] == pytest.approx([0.3, 0.5, 0.3], abs=1e-4)


def test_anisotropy_takes_strength_and_rotation_in(tmp_path: Path) -> None:
    made = many_materials()
    bakes = {bake.materials[0]: bake for bake in materials_of(made, tmp_path).bakes}
    assert [bake.materials[0] for bake in bakes.values() if "anisotropy" in bake.options.maps] == [BRUSHED, COMBED]
    turned = load(bakes[BRUSHED].files, bakes[BRUSHED].options).maps["anisotropy"].pixels
    stored = read_image(tmp_path / "images" / f"{STEMS[DIRECTIONS]}.png").pixels / 255.0
    angle = np.arctan2(stored[..., 1] * 2 - 1, stored[..., 0] * 2 - 1) + 0.5
    # Directions are filtered as vectors where a map is smaller than the others; here only texels that both have.
    assert turned.shape == (16, 16, 3)
    alone = simple(extensions={"KHR_materials_anisotropy": {"anisotropyTexture": {"index": 1}}})
    alone.texture(alone.image(png("directions", 8), "d"))
    alone.json["materials"][0]["extensions"]["KHR_materials_anisotropy"] |= {
        "anisotropyStrength": 0.5,
        "anisotropyRotation": 0.5,
    }
    (tmp_path / "alone").mkdir()
    bake = only(alone, tmp_path / "alone")
    found = load(bake.files, bake.options).maps["anisotropy"].pixels
    long = np.hypot(stored[..., 0] * 2 - 1, stored[..., 1] * 2 - 1) > 0.1
    assert found[..., 0][long] == pytest.approx(np.cos(angle)[long], abs=1e-4)
    assert found[..., 1][long] == pytest.approx(np.sin(angle)[long], abs=1e-4)
    assert found[..., 2] == pytest.approx(0.5 * stored[..., 2], abs=1e-4)
    combed = load(bakes[COMBED].files, bakes[COMBED].options).maps["anisotropy"].pixels
    assert combed == pytest.approx(np.broadcast_to([1, 0, 0.6], combed.shape), abs=1e-4)


@pytest.mark.parametrize(
    ("members", "alpha", "expected"),
    [
        ({}, 4, (None, None)),
        ({"alphaMode": "BLEND"}, 4, ("b.png:A", None)),
        ({"alphaMode": "MASK", "alphaCutoff": 0.3}, 4, ("b.png:A", 0.3)),
        ({"alphaMode": "MASK", "alphaCutoff": 1.5}, 4, ("b.png:A", None)),
        ({"alphaMode": "MASK", "alphaCutoff": 0}, 4, ("b.png:A", None)),
        ({"alphaMode": "MASK"}, 3, (None, None)),
    ],
)
def test_alpha(members: dict[str, Any], alpha: int, expected: tuple[object, object], tmp_path: Path) -> None:
    bake = only(simple(png("base", 8, alpha), **members), tmp_path)
    assert (bake.options.maps["opacity"], bake.options.alpha_cutoff) == expected
    assert any("of its cutoff" in note for note in bake.notes) == (members.get("alphaCutoff") in (0, 1.5))


def test_channels_of_grey_images(tmp_path: Path) -> None:
    pbr = {"metallicRoughnessTexture": {"index": 1}}
    made = simple(png("grey", 8, 1), pbrMetallicRoughness=pbr, occlusionTexture={"index": 1})
    bake = only(made, tmp_path)
    maps = {role: bake.options.maps[role] for role in ("base_color", "roughness", "metallic", "occlusion")}
    assert set(maps.values()) == {"b.png:R"}
    load(bake.files, bake.options)


@pytest.mark.parametrize("slot", ["normalTexture", "anisotropyTexture"])
def test_grey_images_hold_no_directions(slot: str, tmp_path: Path) -> None:
    made = simple(png("grey", 8, 2))
    anisotropy = {"anisotropyStrength": 1, "anisotropyTexture": {"index": 1}}
    changed = {"extensions": {"KHR_materials_anisotropy": anisotropy}}
    made.json["materials"][0] |= {slot: {"index": 1}} if slot == "normalTexture" else changed
    with pytest.raises(InputError, match=rf"image 1 \(b\) is grey, and cannot hold the directions of a {slot}"):
        materials_of(made, tmp_path)


@pytest.mark.parametrize(
    ("sampler", "wrap", "warning"),
    [
        (None, ("wrap", "wrap"), None),
        ({}, ("wrap", "wrap"), None),
        ({"wrapS": 33071}, ("clamp", "wrap"), "repeat in another way"),
        ({"wrapS": 33071, "wrapT": 33648}, ("clamp", "clamp"), "are mirrored at the borders"),
        ({"minFilter": 9729}, ("wrap", "wrap"), "show level 0 alone"),
    ],
)
def test_samplers(sampler: dict[str, int] | None, wrap: tuple[str, str], warning: str | None, tmp_path: Path) -> None:
    made = simple(png("base", 8))
    if sampler is None:
        del made.json["textures"][0]["sampler"]
    else:
        made.json["samplers"].append(sampler)
        made.json["textures"][0]["sampler"] = 1
    bake = only(made, tmp_path)
    assert bake.options.wrap == wrap
    assert any(warning in each for each in bake.warnings) if warning else not bake.warnings


def test_webp_is_read(tmp_path: Path) -> None:
    made = GltfFile()
    webp = write_image(tmp_path / "a.webp", np.tile(np.uint8([128, 128, 255]), (8, 8, 1))).read_bytes()
    image = made.image(webp, "w", "image/webp")
    made.json["textures"].append({"extensions": {"EXT_texture_webp": {"source": image}}})
    made.material("W", normalTexture={"index": 0})
    bake = only(made, tmp_path)
    assert bake.options.maps["normal"] == "w.webp:RGB"
    assert load(bake.files, bake.options).width == 8


def test_names_are_safe_and_unique(tmp_path: Path) -> None:
    made = GltfFile()
    names = ["../Ä b", "a", "A", "", None]
    for index, name in enumerate(names):
        made.texture(made.image(png(f"normal{index * 'x'}", 8), "wood"))
        made.material("", normalTexture={"index": index})
        made.json["materials"][-1]["name"] = made.json["images"][-1]["name"] = name
    found = materials_of(made, tmp_path).bakes
    assert [bake.name for bake in found] == ["Ä_b", "a", "A_2", "material_3", "material_4"]
    assert [bake.files[0].stem for bake in found] == ["Ä_b", "a", "A_2", "image_3", "image_4"]
    (tmp_path / "images of").mkdir()
    path = simple().write(tmp_path / "images of" / "a", "external")
    path.write_text(path.read_text().replace('"name": "n", ', ""))
    (bake,) = read_materials(read_document(path), tmp_path / "images of").bakes
    assert [file.name for file in bake.files] == ["n_of_a.png"]


def test_animations_of_what_is_baked_in_are_reported(tmp_path: Path) -> None:
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
    baked = {
        "alphaCutoff": "0.4",
        "extensions/KHR_materials_anisotropy/anisotropyRotation": "0",
        "extensions/KHR_materials_anisotropy/anisotropyStrength": "0.25",
        "normalTexture/scale": "2",
        "pbrMetallicRoughness/metallicFactor": "1",
        "pbrMetallicRoughness/roughnessFactor": "0.5",
    }
    others = ["/materials/0/emissiveFactor", "/materials/1/normalTexture/scale", "/nodes/0/x", "/materials/x", None, 3]
    pointers = [*(f"/materials/0/{member}" for member in baked), *others]
    extensions = [{"KHR_animation_pointer": {"pointer": pointer}} for pointer in pointers]
    channels = [{"sampler": 0, "target": {"path": "pointer", "extensions": each}} for each in extensions]
    made.json["animations"] = [{"channels": channels, "samplers": [{"input": 0, "output": 1}]}]
    assert only(made, tmp_path).warnings == tuple(
        f"material 0 (M): an animation sets {member}, which is baked in as {value}, its value at rest: what the "
        "animation sets comes on top of that, so look at it in the result"
        for member, value in baked.items()
    )


BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "texture": ({"normalTexture": {"index": 5}}, r"normalTexture of material 0 \(Simple\) names 5 of its 1 textures"),
    "no index": ({"normalTexture": {"scale": 1}}, "names None of its 1 textures"),
    "info": ({"normalTexture": 3}, r"normalTexture of material 0 \(Simple\) is 3, expected an object"),
    "pbr": ({"pbrMetallicRoughness": []}, r"is \[\], expected an object"),
    "roughness": ({"pbrMetallicRoughness": {"roughnessFactor": "1"}}, "roughnessFactor of .* is '1', expected a num"),
    "colour": ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1]}}, "baseColorFactor .*, expected four numbers"),
    "scale": ({"normalTexture": {"index": 0, "scale": None}}, "scale of normalTexture .* is None, expected a number"),
    "alpha": ({"alphaMode": "HASH"}, "alphaMode of .* is 'HASH', expected OPAQUE, MASK or BLEND"),
    "huge offset": (
        {"normalTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0, 10**400]}}}},
        "texture coordinates of normalTexture of .* are not as glTF defines them",
    ),
    "strength": ({"extensions": {"KHR_materials_anisotropy": {"anisotropyStrength": 3}}}, "anisotropyStrength of "),
    "sampler": ({"textures": {"sampler": 4}}, "names 4 of its 1 samplers"),
    "image": ({"textures": {"source": 4}}, "names 4 of its 1 images"),
    "no image": ({"textures": {"source": ...}}, r"texture 0 \(normalTexture of .*\) names no image"),
    "wrap": ({"samplers": {"wrapS": 1}}, "sampler 0 has the wrap mode 1, expected 33071, 33648 or 10497"),
}
"""Members of the material, or of the first object of another array; `...` is none."""


@pytest.mark.parametrize("case", BROKEN)
def test_broken_materials_are_reported_in_a_sentence(case: str, tmp_path: Path) -> None:
    members, message = BROKEN[case]
    arrays = {key: value for key, value in members.items() if key in ("textures", "samplers")}
    made = simple(**{key: value for key, value in members.items() if key not in arrays})
    for array, changed in arrays.items():
        whole = {**made.json[array][0], **changed}
        made.json[array][0] = {key: value for key, value in whole.items() if value is not ...}
    with pytest.raises(InputError, match=message):
        materials_of(made, tmp_path)


def test_materials_that_are_broken_leave_the_others(tmp_path: Path) -> None:
    """What several have in common is reported once, with their names."""
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


def test_pixels_that_are_cut_short_are_reported_with_the_document_alone(tmp_path: Path) -> None:
    """The header is whole. The folder of extracted files is of no use to the reader: it will be gone."""
    jpeg = write_image(tmp_path / "a.jpg", np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8))
    made = simple(jpeg.read_bytes()[:-1500])
    with pytest.raises(InputError, match=r"a.glb: image 1 \(b\) is not a readable image") as caught:
        materials_of(made, tmp_path)
    assert str(tmp_path / "images") not in str(caught.value)


def test_a_document_without_anything_to_bake_is_refused(tmp_path: Path) -> None:
    made = GltfFile()
    with pytest.raises(InputError, match=r"a.glb has no material to bake \(it has none at all\): expected one with"):
        materials_of(made, tmp_path)
    for name in "abcd":
        made.material(name)
    with pytest.raises(InputError, match=r"\(material 0 \(a\) has neither .*; and 1 more\)"):
        materials_of(made, tmp_path)


@pytest.mark.parametrize(
    ("members", "warning"),
    [
        ({"normalTexture": {"index": 0, "scale": -0.5}}, "scale of its normalTexture is -0.5, which inverts its bumps"),
        (
            {"extensions": {"KHR_materials_anisotropy": {"anisotropyStrength": 1.0, "anisotropyTexture": APART}}},
            "its anisotropyTexture and its normalTexture lie on different",
        ),
    ],
)
def test_a_material_that_is_left_as_it_is_does_not_keep_others(
    members: dict[str, Any], warning: str, tmp_path: Path
) -> None:
    made = simple(**members)
    made.material("Other", normalTexture={"index": 0})
    found = materials_of(made, tmp_path)
    assert [bake.materials for bake in found.bakes] == [(1,)]
    assert warning in found.warnings[0]
