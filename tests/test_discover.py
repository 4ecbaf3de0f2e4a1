"""Finding the maps of a set: names of every provider, preferences, options, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError, UsageError
from mipbake.source.names import classify, interpretations
from mipbake.source.options import CARRIED, ROLES

from .input_files import encoded, find, height_field, pixels_for, plain_set, write_image, write_set

# Provider: file name to pixels and role:channels, with - where they are inverted.
Files = dict[str, tuple[str, str]]
PROVIDERS: dict[str, Files] = {
    "ambientcg": {
        "Metal007_1K-JPG_Color.jpg": ("base_color", "base_color:RGB"),
        "Metal007_1K-JPG_NormalGL.jpg": ("normal", "normal:RGB"),
        "Metal007_1K-JPG_Roughness.jpg": ("roughness", "roughness:Y"),
        "Metal007_1K-JPG_Metalness.jpg": ("metallic", "metallic:Y"),
        "Metal007_1K-JPG_AmbientOcclusion.jpg": ("occlusion", "occlusion:Y"),
        "Metal007_1K-JPG_Displacement.jpg": ("height", "height:Y"),
        "Metal007_1K-JPG_Emission.jpg": ("emissive", "emissive:RGB"),
        "Metal007_1K-JPG_Opacity.jpg": ("opacity", "opacity:Y"),
        "Metal007_1K-JPG.png": ("base_color", ""),
        "Metal007.png": ("base_color", ""),
    },
    "polyhaven": {
        "rusty_metal_02_diff_4k.jpg": ("base_color", "base_color:RGB"),
        "rusty_metal_02_nor_gl_4k.png": ("normal", "normal:RGB"),
        "rusty_metal_02_rough_4k.png": ("roughness", "roughness:Y"),
        "rusty_metal_02_metal_4k.png": ("metallic", "metallic:Y"),
        "rusty_metal_02_ao_4k.png": ("occlusion", "occlusion:Y"),
        "rusty_metal_02_disp_4k.png": ("height", "height:Y"),
        "rusty_metal_02_arm_4k.png": ("packed", ""),
        "rusty_metal_02_spec_4k.png": ("specular", ""),
    },
    "polyhaven packed": {
        "metal_plate_diff_1k.jpg": ("base_color", "base_color:RGB"),
        "metal_plate_nor_gl_1k.png": ("normal", "normal:RGB"),
        "metal_plate_arm_1k.png": ("packed", "occlusion:R roughness:G metallic:B"),
    },
    "substance": {
        "Robot_Body_BaseColor.png": ("base_color", "base_color:RGB"),
        "Robot_Body_Normal_OpenGL.png": ("normal", "normal:RGB"),
        "Robot_Body_Roughness.png": ("roughness", "roughness:Y"),
        "Robot_Body_Metallic.png": ("metallic", "metallic:Y"),
        "Robot_Body_Mixed_AO.png": ("occlusion", "occlusion:Y"),
        "Robot_Body_Height.png": ("height", "height:Y"),
        "Robot_Body_Emissive.png": ("emissive", "emissive:RGB"),
    },
    "unreal": {
        "T_Rock_BC.png": ("base_color", "base_color:RGB"),
        "T_Rock_N.png": ("normal", "normal:RGB"),
        "T_Rock_ORM.png": ("packed", "occlusion:R roughness:G metallic:B"),
        "T_Rock_E.png": ("emissive", "emissive:RGB"),
    },
    "unreal single": {
        "T_Rock_D.png": ("base_color", "base_color:RGB"),
        "T_Rock_N.png": ("normal", "normal:RGB"),
        "T_Rock_R.png": ("roughness", "roughness:Y"),
        "T_Rock_M.png": ("metallic", "metallic:Y"),
    },
    "unity": {
        "Crate_AlbedoTransparency.png": ("packed_alpha", "base_color:RGB opacity:A"),
        "Crate_Normal.png": ("normal", "normal:RGB"),
        "Crate_MetallicSmoothness.png": ("packed_alpha", "metallic:R roughness:A-"),
    },
    "unity material": {
        "Crate_MainTex.png": ("base_color", "base_color:RGB"),
        "Crate_BumpMap.png": ("normal", "normal:RGB"),
        "Crate_MetallicGlossMap.png": ("packed_alpha", "metallic:R roughness:A-"),
        "Crate_OcclusionMap.png": ("occlusion", "occlusion:Y"),
        "Crate_EmissionMap.png": ("emissive", "emissive:RGB"),
    },
    "gltf": {
        "Helmet_baseColor.png": ("base_color", "base_color:RGB"),
        "Helmet_normal.png": ("normal", "normal:RGB"),
        "Helmet_metallicRoughness.png": ("packed", "roughness:G metallic:B"),
        "Helmet_occlusion.png": ("occlusion", "occlusion:Y"),
        "Helmet_anisotropy.png": ("anisotropy", "anisotropy:RGB"),
    },
    "gltf packed": {
        "baseColor.png": ("base_color", "base_color:RGB"),
        "normal.png": ("normal", "normal:RGB"),
        "occlusionRoughnessMetallic.png": ("packed", "occlusion:R roughness:G metallic:B"),
    },
    "scans": {
        "vbrkbj_2K_Albedo.jpg": ("base_color", "base_color:RGB"),
        "vbrkbj_2K_Normal_LOD0.jpg": ("normal", "normal:RGB"),
        "vbrkbj_2K_Gloss.jpg": ("roughness", "roughness:Y-"),
        "vbrkbj_2K_Cavity.jpg": ("occlusion", ""),
    },
    "megascans": {
        "T_Moss_2K_D.png": ("base_color", "base_color:RGB"),
        "T_Moss_2K_N.png": ("normal", "normal:RGB"),
        "T_Moss_2K_ORDp.png": ("packed", "occlusion:R roughness:G height:B"),
    },
    "mask with detail": {
        "Moss_Albedo.png": ("base_color", "base_color:RGB"),
        "Moss_Normal.png": ("normal", "normal:RGB"),
        "Moss_MADS.png": ("packed_alpha", "metallic:R occlusion:G roughness:A-"),
    },
    "cryengine": {
        "wall_diff.png": ("base_color", "base_color:RGB"),
        "wall_ddna.png": ("normal_alpha", "normal:RGB roughness:A-"),
        "wall_displ.png": ("height", "height:Y"),
    },
    "ambient occlusion in two letters": {
        "crate_albedo.png": ("base_color", "base_color:RGB"),
        "crate_nmp.png": ("normal", "normal:RGB"),
        "crate_mrao.png": ("packed", "metallic:R roughness:G occlusion:B"),
    },
    "copies": {
        "wood_basecolor (1).png": ("base_color", "base_color:RGB"),
        "wood_ddn(2).png": ("normal", "normal:RGB"),
        "wood_rough_1k - Copy (2).png": ("roughness", "roughness:Y"),
        "wood_metallic copy 3.png": ("metallic", "metallic:Y"),
    },
    "plain": {
        "albedo.png": ("base_color", "base_color:RGB"),
        "normals.png": ("normal", "normal:RGB"),
        "smoothness.png": ("roughness", "roughness:Y-"),
        "metal.png": ("metallic", "metallic:Y"),
        "bump.png": ("height", "height:Y"),
    },
}


@pytest.mark.parametrize("provider", PROVIDERS)
def test_every_file_of_a_provider_fills_its_roles(provider: str, tmp_path: Path) -> None:
    files = PROVIDERS[provider]
    write_set(tmp_path, {name: pixels for name, (pixels, _) in files.items()})
    found = find(tmp_path)
    filled = [(name, *how.split(":")) for name, (_, roles) in files.items() for how in roles.split()]
    expected = {role: (name, letters.removesuffix("-"), letters.endswith("-")) for name, role, letters in filled}
    actual = {r: (s.path.name, s.channels, s.inverted) for r, s in found.maps.items() if s.path is not None}
    carried = {r: actual.pop(r) for r in list(actual) if r.startswith(CARRIED)}
    assert actual == expected
    for name, letter, _ in carried.values():  # beside channels that have a role, and none of those
        taken = "".join(letters for other, letters, _ in actual.values() if other == name)
        assert taken and letter not in taken
    assert {i.path.name for i in found.ignored} == {name for name, (_, roles) in files.items() if not roles}
    assert all(i.reason for i in found.ignored)


@pytest.mark.parametrize(
    ("stem", "convention"),
    [
        ("a_NormalGL", "opengl"),
        ("a_nor_gl_1k", "opengl"),
        ("a_Normal_OpenGL", "opengl"),
        ("a-normal-ogl", "opengl"),
        ("NormalDX", "directx"),
        ("a_nor_dx_8k", "directx"),
        ("a_Normal_DirectX", "directx"),
        ("a_normal", None),
        ("T_a_N", None),
    ],
)
def test_names_tell_the_normal_convention(stem: str, convention: str | None) -> None:
    (match,) = classify([stem])
    assert match is not None
    assert [(m.role, m.convention) for m in match.meanings] == [("normal", convention)]


@pytest.mark.parametrize(
    "stem",
    [
        "Metal007",
        "Metal007_1K-JPG",
        "Concrete044D",
        "Tiles136C_2K",
        "rusty_metal_02",
        "rough_wall_3",
        "rough_1",
        "nomads",
        "(1)",
        "preview",
        "1k",
        "",
    ],
)
def test_names_of_sets_say_no_role(stem: str) -> None:
    assert interpretations(stem) == []


@pytest.mark.parametrize("stem", ["a_Specular_Color", "coat_roughness", "a_ClearcoatNormal", "a_detail_normal", "a_id"])
def test_maps_of_other_lobes_are_recognised_and_not_used(stem: str) -> None:
    match, _ = classify([f"{stem}", "a_normal" if stem.startswith("a_") else "normal"])
    assert match is not None
    assert match.meanings == ()


def test_words_of_the_set_are_not_taken_for_packed_maps(tmp_path: Path) -> None:
    names = ["rough_coat_color", "rough_coat_normal", "rough_coat_roughness", "rough_coat_metal_rough"]
    assert [m and m.meanings[0].role for m in classify(names[:3])] == ["base_color", "normal", "roughness"]
    assert [m and m.word for m in classify([*names[:2], names[3]])] == ["color", "normal", "metalrough"]
    names = ["old_metal_color", "old_metal_normal", "old_metal_rough", "old_metal_metal"]
    assert [m and m.word for m in classify(names)] == ["color", "normal", "rough", "metal"]


def test_a_preview_named_like_the_set_is_no_map(tmp_path: Path) -> None:
    names = {"brushed_metal_color.png": "base_color", "brushed_metal_normal_gl.png": "normal"}
    write_set(tmp_path, names | {"brushed_metal_rough.png": "roughness", "brushed_metal.png": "base_color"})
    (tmp_path / "brushed_metal.usdc").write_bytes(b"PXR-USDC")
    found = find(tmp_path)
    assert found.maps["metallic"].path is None
    reasons = {i.path.name: i.reason for i in found.ignored}
    assert "preview" in reasons["brushed_metal.png"]
    assert reasons["brushed_metal.usdc"] == "not an image"


def test_hidden_files_are_not_even_listed(tmp_path: Path) -> None:
    plain_set(tmp_path)
    (tmp_path / "._normal_gl.png").write_bytes(b"resource fork")
    assert find(tmp_path).ignored == ()


def test_the_textures_folder_inside_is_read(tmp_path: Path) -> None:
    plain_set(tmp_path / "old wall!" / "textures")
    (tmp_path / "old wall!" / "old_wall.blend").write_bytes(b"BLENDER")
    found = find(tmp_path / "old wall!")
    assert found.name == "old_wall"
    assert found.maps["normal"].path == tmp_path / "old wall!" / "textures" / "normal_gl.png"


def test_names_keep_the_letters_of_every_script(tmp_path: Path) -> None:
    names = {"石": "石", "木": "木", "Straße (2)": "Straße_2", "пол 4": "пол_4"}
    for folder, expected in names.items():
        assert find(plain_set(tmp_path / folder)).name == expected


def test_a_textures_folder_is_named_after_its_parent(tmp_path: Path) -> None:
    folder = plain_set(tmp_path / "oak" / "Textures")
    assert find(folder).name == "oak"
    assert mipbake.load(sorted(folder.iterdir())).name == "oak"


def test_files_can_be_given_one_by_one(tmp_path: Path) -> None:
    folder = plain_set(tmp_path / "wall", metallic="metallic")
    found = mipbake.load(folder / f"{s}.png" for s in ("normal_gl", "roughness"))
    assert found.maps["metallic"].source.path is None
    assert found.name == "wall"


def test_of_both_conventions_opengl_is_taken_unless_the_option_says_otherwise(tmp_path: Path) -> None:
    plain_set(tmp_path, normal_dx=encoded(height_field(32, 32), directx=True))
    found = find(tmp_path)
    assert found.maps["normal"].path == tmp_path / "normal_gl.png"
    assert found.normal_convention.name == "opengl"
    assert any("both normal conventions" in n for n in found.notes)
    found = find(tmp_path, normal_convention="directx")
    assert found.maps["normal"].path == tmp_path / "normal_dx.png"
    assert found.normal_convention.name == "directx"


@pytest.mark.parametrize(
    ("second", "role", "winner"),
    [
        ({"orm": "packed"}, "roughness", "roughness.png"),
        ({"gloss": "roughness"}, "roughness", "roughness.png"),
        ({"height": "height", "bump": "height"}, "height", "height.png"),
        ({"roughness (1)": "roughness", "roughness - Copy": "roughness"}, "roughness", "roughness.png"),
    ],
)
def test_a_map_of_its_own_is_preferred_and_that_is_said(
    second: dict[str, str], role: str, winner: str, tmp_path: Path
) -> None:
    plain_set(tmp_path, **second)
    found = find(tmp_path)
    source = found.maps[role]
    assert source.path is not None
    assert (source.path.name, source.inverted) == (winner, False)
    assert any(n.startswith(f"{role}: {winner} is preferred") for n in found.notes)


@pytest.mark.parametrize(
    ("extra", "role"),
    [
        ("albedo.png", "base_color"),
        ("rough.png", "roughness"),
        ("roughness.tif", "roughness"),
        ("normal.png", "normal"),
    ],
)
def test_two_candidates_are_refused_by_name(extra: str, role: str, tmp_path: Path) -> None:
    plain_set(tmp_path)
    write_image(tmp_path / extra, pixels_for(role))
    with pytest.raises(InputError, match=f"all match {role}.*{role}=FILE") as error:
        find(tmp_path)
    assert extra in str(error.value)
    chosen = find(tmp_path, maps={role: extra})
    assert chosen.maps[role].path == tmp_path / extra


def test_a_missing_folder_a_file_and_an_empty_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        find(tmp_path / "nowhere")
    file = write_image(tmp_path / "normal.png", pixels_for("normal"))
    with pytest.raises(InputError, match="is a file"):
        find(file)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is empty"):
        find(tmp_path / "empty")
    with pytest.raises(InputError, match="no files"):
        mipbake.load([])
    with pytest.raises(InputError, match="is not a file"):
        mipbake.load([tmp_path / "gone.png"])


@pytest.mark.parametrize("missing", [["normal_gl"], ["roughness"], ["normal_gl", "roughness"]])
def test_without_normal_or_roughness_what_was_found_is_listed(missing: list[str], tmp_path: Path) -> None:
    plain_set(tmp_path, surface="base_color")
    for stem in missing:
        (tmp_path / f"{stem}.png").unlink()
    with pytest.raises(InputError) as error:
        find(tmp_path)
    message = str(error.value)
    for stem in missing:
        assert f"no {stem.removesuffix('_gl')}" in message
    assert "base_color.png (base colour)" in message
    assert "surface.png (its name says no role)" in message


def test_alpha_is_never_taken_for_green(tmp_path: Path) -> None:
    grey_alpha = np.stack([pixels_for("roughness")[..., 0], np.full((32, 32), 255, np.uint8)], -1)
    folder = plain_set(tmp_path, wear=grey_alpha)
    for channel in "GB":
        with pytest.raises(InputError, match=f"no channel {channel}.*R and A"):
            find(folder, maps={"roughness": f"wear.png:{channel}"})
    for channel, expected in (("R", "Y"), ("A", "A")):
        found = find(folder, maps={"roughness": f"wear.png:{channel}"})
        assert found.maps["roughness"].channels == expected
    write_image(folder / "normal_gl.png", pixels_for("normal")[..., :2])
    assert find(folder, maps={"normal": "normal_gl.png:RG"}).maps["normal"].channels == "RG"


def test_a_folder_of_folders_lists_them(tmp_path: Path) -> None:
    for name in ("oak", "pine", ".hidden"):
        plain_set(tmp_path / name)
    with pytest.raises(InputError, match=r"did you mean \S+oak, \S+pine\?$"):
        find(tmp_path)


def test_an_unknown_colour_space_is_refused_with_near_names(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="ACEScg"):
        find(plain_set(tmp_path), colour_space="ACEScq")


def test_a_packed_name_on_a_grey_file_is_refused(tmp_path: Path) -> None:
    write_set(tmp_path, {"normal_gl.png": "normal", "a_orm.png": "roughness"})
    with pytest.raises(InputError, match=r"grey, but its name \(orm\)"):
        find(tmp_path)


def test_sizes_agree_or_are_resampled(tmp_path: Path) -> None:
    plain_set(tmp_path / "a", roughness=pixels_for("roughness", 16), metallic=pixels_for("metallic", 1))
    found = find(tmp_path / "a")
    assert (found.width, found.height) == (32, 32)
    assert any("roughness.png: resampled from 16 x 16 to 32 x 32" in n for n in found.notes)
    plain_set(tmp_path / "b", roughness=pixels_for("roughness", 32)[:16])
    found = find(tmp_path / "b")
    assert (found.width, found.height) == (32, 32)
    assert [w for w in found.warnings if "32 x 16 to 32 x 32" in w and "is 32 x 32" in w and "roughness.png" in w]
    assert not any("resampled" in n for n in found.notes)
    plain_set(tmp_path / "c", height=pixels_for("height", 32)[:16])
    assert find(tmp_path / "c").maps["height"].height == 16


def test_sixteen_bit_colours_are_srgb_and_that_is_said(tmp_path: Path) -> None:
    plain_set(tmp_path)
    write_image(tmp_path / "base_color.png", np.full((32, 32, 3), 30000, np.uint16))
    found = find(tmp_path)
    assert found.maps["base_color"].encoding == "sRGB"
    assert any("uint16 values are taken as sRGB" in n for n in found.notes)


def test_roles_come_in_one_order(tmp_path: Path) -> None:
    found = find(plain_set(tmp_path, opacity="opacity", ao="occlusion", metallic="metallic"))
    assert list(found.maps) == [r for r in ROLES if r in found.maps]
