"""Finding the maps of a set: names of every provider, preferences, options, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.base.errors import InputError, UsageError
from mipbake.source.names import classify, interpretations
from mipbake.source.options import CARRIED, ROLES, LoadOptions

from .input_files import encoded, find, height_field, pixels_for, plain_set, write_image, write_set

# What the names of a provider's files begin with, then each name with what it is: roles with their channels where they
# are not all of the file, and - where they are inverted. ~ stands for a space.
PROVIDERS = {
    "ambientcg": "Metal007 _1K-JPG_Color.jpg=base_color _1K-JPG_NormalGL.jpg=normal _1K-JPG_Roughness.jpg=roughness "
    "_1K-JPG_Metalness.jpg=metallic _1K-JPG_AmbientOcclusion.jpg=occlusion _1K-JPG_Displacement.jpg=height "
    "_1K-JPG_Emission.jpg=emissive _1K-JPG_Opacity.jpg=opacity _1K-JPG.png= .png=",
    "polyhaven": "rusty_metal_02_ diff_4k.jpg=base_color nor_gl_4k.png=normal rough_4k.png=roughness "
    "metal_4k.png=metallic ao_4k.png=occlusion disp_4k.png=height arm_4k.png= spec_4k.png=",
    "polyhaven packed": "metal_plate_ diff_1k.jpg=base_color nor_gl_1k.png=normal "
    "arm_1k.png=occlusion:R,roughness:G,metallic:B",
    "substance": "Robot_Body_ BaseColor.png=base_color Normal_OpenGL.png=normal Roughness.png=roughness "
    "Metallic.png=metallic Mixed_AO.png=occlusion Height.png=height Emissive.png=emissive",
    "unreal": "T_Rock_ BC.png=base_color N.png=normal ORM.png=occlusion:R,roughness:G,metallic:B E.png=emissive",
    "unreal single": "T_Rock_ D.png=base_color N.png=normal R.png=roughness M.png=metallic",
    "unity": "Crate_ AlbedoTransparency.png=base_color:RGB,opacity:A Normal.png=normal "
    "MetallicSmoothness.png=metallic:R,roughness:A-",
    "unity material": "Crate_ MainTex.png=base_color BumpMap.png=normal MetallicGlossMap.png=metallic:R,roughness:A- "
    "OcclusionMap.png=occlusion EmissionMap.png=emissive",
    "gltf": "Helmet_ baseColor.png=base_color normal.png=normal metallicRoughness.png=roughness:G,metallic:B "
    "occlusion.png=occlusion anisotropy.png=anisotropy",
    "gltf packed": "a_ baseColor.png=base_color normal.png=normal "
    "occlusionRoughnessMetallic.png=occlusion:R,roughness:G,metallic:B",
    "scans": "vbrkbj_2K_ Albedo.jpg=base_color Normal_LOD0.jpg=normal Gloss.jpg=roughness:Y- Cavity.jpg=",
    "megascans": "T_Moss_2K_ D.png=base_color N.png=normal ORDp.png=occlusion:R,roughness:G,height:B",
    "mask with detail": "Moss_ Albedo.png=base_color Normal.png=normal MADS.png=metallic:R,occlusion:G,roughness:A-",
    "cryengine": "wall_ diff.png=base_color ddna.png=normal:RGB,roughness:A- displ.png=height",
    "ambient occlusion in two letters": "crate_ albedo.png=base_color nmp.png=normal "
    "mrao.png=metallic:R,roughness:G,occlusion:B",
    "copies": "wood_ basecolor~(1).png=base_color ddn(2).png=normal rough_1k~-~Copy~(2).png=roughness "
    "metallic~copy~3.png=metallic",
    "plain": "- albedo.png=base_color normals.png=normal smoothness.png=roughness:Y- metal.png=metallic "
    "bump.png=height",
}


@pytest.mark.parametrize("provider", PROVIDERS)
def test_every_file_of_a_provider_fills_its_roles(provider: str, tmp_path: Path) -> None:
    start, *files = PROVIDERS[provider].split()
    expected: dict[str, tuple[str, str, bool]] = {}
    left_out = set()
    for word in files:
        end, _, roles = word.replace("~", " ").partition("=")
        name = f"{start.strip('-')}{end}"
        alpha = ":A" in roles
        kind = "packed" if "," in roles else roles.partition(":")[0] or "base_color"
        kind = "normal_alpha" if alpha and "normal" in roles else "packed_alpha" if alpha else kind
        write_image(tmp_path / name, pixels_for(kind))
        for role, _, letters in (each.partition(":") for each in roles.split(",") if each):
            whole = "RGB" if role in ("base_color", "normal", "emissive", "anisotropy") else "Y"
            expected[role] = (name, letters.removesuffix("-") or whole, letters.endswith("-"))
        left_out |= set() if roles else {name}
    found = find(tmp_path)
    actual = {r: (s.path.name, s.channels, s.inverted) for r, s in found.maps.items() if s.path is not None}
    carried = {r: actual.pop(r) for r in list(actual) if r.startswith(CARRIED)}
    assert actual == expected
    for name, letter, _ in carried.values():  # beside channels that have a role, and none of those
        taken = "".join(letters for other, letters, _ in actual.values() if other == name)
        assert taken and letter not in taken
    assert {i.path.name for i in found.ignored} == left_out and all(i.reason for i in found.ignored)


@pytest.mark.parametrize(
    ("stem", "convention"),
    [
        *((stem, "opengl") for stem in ("a_NormalGL", "a_nor_gl_1k", "a-normal-ogl")),
        *((stem, "directx") for stem in ("NormalDX", "a_nor_dx_8k", "a_Normal_DirectX")),
        *((stem, None) for stem in ("a_normal", "T_a_N")),
    ],
)
def test_names_say_the_normal_convention(stem: str, convention: str | None) -> None:
    (match,) = classify([stem])
    assert [(m.role, m.convention) for m in match.meanings] == [("normal", convention)]


@pytest.mark.parametrize(
    "stem",
    [
        *("Metal007", "Metal007_1K-JPG", "Concrete044D", "Tiles136C_2K", "rusty_metal_02", "rough_wall_3", "rough_1"),
        *("nomads", "(1)", "preview", "1k", ""),
        *("gunmetal", "unsmooth", "bitmask", "bold", "Ambrosia", "encore", "bump2"),
    ],
)
def test_names_of_sets_say_no_role(stem: str) -> None:
    assert interpretations(stem) == []


@pytest.mark.parametrize("stem", ["a_Specular_Color", "coat_roughness", "a_ClearcoatNormal", "a_detail_normal", "a_id"])
def test_maps_of_other_lobes_are_recognised_and_not_used(stem: str) -> None:
    match, _ = classify([f"{stem}", "a_normal" if stem.startswith("a_") else "normal"])
    assert match.meanings == ()


def test_words_of_the_set_are_not_taken_for_packed_maps() -> None:
    names = ["rough_coat_color", "rough_coat_normal", "rough_coat_roughness", "rough_coat_metal_rough"]
    assert [m and m.meanings[0].role for m in classify(names[:3])] == ["base_color", "normal", "roughness"]
    assert [m and m.word for m in classify([*names[:2], names[3]])] == ["color", "normal", "metalrough"]
    names = ["old_metal_color", "old_metal_normal", "old_metal_rough", "old_metal_metal"]
    assert [m and m.word for m in classify(names)] == ["color", "normal", "rough", "metal"]


def test_names_that_end_in_the_workflow() -> None:
    """Poliigon has such names."""
    stems = [f"Tiles001_{word}_2K_METALNESS" for word in ("COL_VAR1", "NRM", "ROUGHNESS", "METALNESS")]
    roles = [match and match.meanings[0].role for match in classify(stems)]
    assert roles == ["base_color", "normal", "roughness", "metallic"]
    assert classify(["Metal007_1K_Metalness"])[0].meanings[0].role == "metallic"


def test_files_that_are_no_maps_are_left_out(tmp_path: Path) -> None:
    names = {"brushed_metal_color.png": "base_color", "brushed_metal_normal_gl.png": "normal"}
    write_set(tmp_path, names | {"brushed_metal_rough.png": "roughness", "brushed_metal.png": "base_color"})
    (tmp_path / "brushed_metal.usdc").write_bytes(b"PXR-USDC")
    (tmp_path / "._normal_gl.png").write_bytes(b"a hidden resource fork")
    found = find(tmp_path)
    assert found.maps["metallic"].path is None
    reasons = {i.path.name: i.reason for i in found.ignored}
    assert reasons.keys() == {"brushed_metal.png", "brushed_metal.usdc"}
    assert "preview" in reasons["brushed_metal.png"] and reasons["brushed_metal.usdc"] == "not an image"


def test_sets_are_called_after_their_folder(tmp_path: Path) -> None:
    """Or after the folder around a folder of textures; names keep the letters of every script."""
    plain_set(tmp_path / "old wall!" / "textures")
    (tmp_path / "old wall!" / "old_wall.blend").write_bytes(b"BLENDER")
    found = find(tmp_path / "old wall!")
    assert found.name == "old_wall" and list(found.maps) == [role for role in ROLES if role in found.maps]
    assert found.maps["normal"].path == tmp_path / "old wall!" / "textures" / "normal_gl.png"
    assert find(tmp_path / "old wall!" / "textures").name == "old_wall"
    for folder, expected in {"石": "石", "Straße (2)": "Straße_2", "пол 4": "пол_4"}.items():
        assert find(plain_set(tmp_path / folder)).name == expected
    folder = plain_set(tmp_path / "wall", metallic="metallic")
    given = mipbake.load(folder / f"{stem}.png" for stem in ("normal_gl", "roughness"))
    assert given.name == "wall" and given.maps["metallic"].source.path is None


def test_of_both_conventions_opengl_is_taken_unless_the_option_says_otherwise(tmp_path: Path) -> None:
    plain_set(tmp_path, normal_dx=encoded(height_field(32, 32), directx=True))
    found = find(tmp_path)
    assert found.maps["normal"].path == tmp_path / "normal_gl.png"
    assert found.normal_convention.name == "opengl" and any("both normal conventions" in n for n in found.notes)
    found = find(tmp_path, normal_convention="directx")
    assert found.maps["normal"].path == tmp_path / "normal_dx.png" and found.normal_convention.name == "directx"


@pytest.mark.parametrize(
    ("second", "role", "winner"),
    [
        ({"orm": "packed"}, "roughness", "roughness.png"),
        ({"gloss": "roughness"}, "roughness", "roughness.png"),
        ({"height": "height", "bump": "height"}, "height", "height.png"),
        ({"roughness (1)": "roughness", "roughness - Copy": "roughness"}, "roughness", "roughness.png"),
        ({"watercolor": "base_color"}, "base_color", "base_color.png"),
        ({"metal_VAR2_4K": "metallic", "metal_VAR1_4K": "metallic"}, "metallic", "metal_VAR1_4K.png"),
    ],
)
def test_a_map_of_its_own_is_preferred_and_that_is_said(second, role, winner, tmp_path):
    plain_set(tmp_path, **second)
    found = find(tmp_path)
    source = found.maps[role]
    assert source.path is not None and (source.path.name, source.inverted) == (winner, False)
    assert any(n.startswith(f"{role}: {winner} is preferred") for n in found.notes)


@pytest.mark.parametrize(("extra", "role"), [("albedo.png", "base_color"), ("roughness.tif", "roughness")])
def test_two_candidates_are_refused_by_name(extra: str, role: str, tmp_path: Path) -> None:
    plain_set(tmp_path)
    write_image(tmp_path / extra, pixels_for(role))
    with pytest.raises(InputError, match=f"all match {role}.*{role}=FILE") as error:
        find(tmp_path)
    assert extra in str(error.value)
    assert find(tmp_path, maps={role: extra}).maps[role].path == tmp_path / extra


def test_what_holds_no_set_is_refused(tmp_path: Path) -> None:
    file = write_image(tmp_path / "normal.png", pixels_for("normal"))
    (tmp_path / "empty").mkdir()
    for name in ("oak", "pine", ".hidden"):
        plain_set(tmp_path / "woods" / name)
    for source, told in (
        (tmp_path / "nowhere", "does not exist"),
        (file, "is a file"),
        (tmp_path / "empty", "is empty"),
        (tmp_path / "woods", r"no images.* as in \S+oak, \S+pine; `mipbake bake --recursive`"),
        ([], "no files"),
        ([tmp_path / "gone.png"], "is not a file"),
    ):
        with pytest.raises(InputError, match=told):
            mipbake.load(source)


@pytest.mark.parametrize("missing", [["normal_gl"], ["normal_gl", "roughness"]])
def test_without_normal_or_roughness_what_was_found_is_listed(missing: list[str], tmp_path: Path) -> None:
    plain_set(tmp_path, surface="base_color")
    for stem in missing:
        (tmp_path / f"{stem}.png").unlink()
    with pytest.raises(InputError) as error:
        find(tmp_path)
    message = str(error.value)
    for part in (
        *(f"no {stem.removesuffix('_gl')}" for stem in missing),
        "base_color.png (base colour)",
        "surface.png",
    ):
        assert part in message


def test_alpha_is_never_taken_for_green(tmp_path: Path) -> None:
    grey_alpha = np.stack([pixels_for("roughness")[..., 0], np.full((32, 32), 255, np.uint8)], -1)
    folder = plain_set(tmp_path, wear=grey_alpha)
    for channel in "GB":
        with pytest.raises(InputError, match=f"no channel {channel}.*R and A"):
            find(folder, maps={"roughness": f"wear.png:{channel}"})
    for channel, expected in (("R", "Y"), ("A", "A")):
        assert find(folder, maps={"roughness": f"wear.png:{channel}"}).maps["roughness"].channels == expected
    write_image(folder / "normal_gl.png", pixels_for("normal")[..., :2])
    assert find(folder, maps={"normal": "normal_gl.png:RG"}).maps["normal"].channels == "RG"


def test_a_packed_name_on_a_grey_file_is_refused(tmp_path: Path) -> None:
    write_set(tmp_path, {"normal_gl.png": "normal", "a_orm.png": "roughness"})
    with pytest.raises(InputError, match=r"grey, but its name \(orm\)"):
        find(tmp_path)


# ---- options


def test_options_fill_roles(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set", {"a.png": "normal", "b.png": "packed_alpha", "c_normal.png": "normal"})
    write_image(tmp_path / "elsewhere.png", pixels_for("height", 16))
    chosen = {"normal": "a.png", "roughness": "b.png:g", "opacity": "b.png:A", "height": tmp_path / "elsewhere.png"}
    found = find(folder, maps={**chosen, "metallic": 1, "base_color": 0.25}, normal_convention="opengl")
    assert {r: (s.path.name if s.path else s.constant, s.channels) for r, s in found.maps.items()} == {
        "base_color": ((0.25, 0.25, 0.25), ""),
        "normal": ("a.png", "RGB"),
        "roughness": ("b.png", "G"),
        "metallic": ((1.0,), ""),
        "height": ("elsewhere.png", "Y"),
        "opacity": ("b.png", "A"),
        "carried_1": ("b.png", "R"),
        "carried_2": ("b.png", "B"),
    }
    assert [(i.path.name, "another" in i.reason) for i in found.ignored] == [("c_normal.png", True)]


def test_a_file_chosen_by_option_is_still_read_as_its_name_says(tmp_path: Path) -> None:
    plain_set(tmp_path, orm="packed", gloss="roughness")
    assert find(tmp_path, maps={"roughness": "orm.png"}).maps["roughness"].channels == "G"
    assert find(tmp_path, maps={"roughness": "gloss.png"}).maps["roughness"].inverted
    asked = {"maps": {"roughness": "gloss.png"}, "roughness_is_gloss": False}
    assert not find(tmp_path, **asked).maps["roughness"].inverted
    assert find(tmp_path, roughness_is_gloss=True).maps["roughness"].inverted


def test_left_out_maps_become_constants_or_disappear(tmp_path: Path) -> None:
    plain_set(tmp_path, metallic="metallic", ao="occlusion")
    found = find(tmp_path, maps={"normal": None, "metallic": None, "occlusion": None})
    assert found.maps["normal"].constant == (0, 0, 1) and found.normal_convention.decided_by == "flat"
    assert found.maps["metallic"].constant == (0,) and any("no metallic map" in n for n in found.notes)
    assert "occlusion" not in found.maps


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"maps": {"rust": "a.png"}}, "unknown map 'rust'.*roughness"),
        ({"maps": {"roughness": 1.5}}, "from 0 to 1"),
        ({"maps": {"height": float("nan")}}, "height is nan: expected a finite number or a file$"),
        ({"maps": {"metallic": float("inf")}}, "metallic is inf: expected a number from 0 to 1"),
        ({"maps": {"roughness": None}}, "cannot be left out"),
        ({"maps": {"normal": 0.5}}, "cannot be the number"),
        ({"maps": {"metallic": True}}, "expected a file, a number or None"),
        ({"normal_convention": "vulkan"}, "opengl, directx"),
        ({"wrap": ("wrap", "mirror")}, "wrap, clamp"),
        ({"wrap": "wrap"}, "two modes"),
        ({"factors": {"height": 2}}, "takes no factor"),
        ({"alpha_cutoff": 0}, "above 0"),
    ],
)
def test_impossible_options_are_refused(arguments: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        LoadOptions(**arguments)


def test_options_that_name_what_is_not_there_are_refused(tmp_path: Path) -> None:
    plain_set(tmp_path)
    for role, choice, told in (
        ("roughness", "gone.png", "no such file"),
        ("roughness", "roughness.png:B", "no channel B"),
        ("opacity", "base_color.png:A", "no channel A"),
    ):
        with pytest.raises(InputError, match=told):
            find(tmp_path, maps={role: choice})
    with pytest.raises(UsageError, match="expected 1 of"):
        find(tmp_path, maps={"roughness": "base_color.png:RG"})
    with pytest.raises(UsageError, match="ACEScg"):
        find(tmp_path, colour_space="ACEScq")
