"""Base colours that nobody's list of names holds, colour spaces in names, and sets that have no colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mipbake.base import colour
from mipbake.base.colour import LINEAR, canonical_colour_space, decode
from mipbake.base.colour_science import colour_science
from mipbake.base.colour_spaces import COLOUR_SPACES
from mipbake.base.errors import InputError, UsageError
from mipbake.source.images.colour_names import RAW, split_colour_space
from mipbake.source.names import classify, colour_space_of, interpretations

from .input_files import find, pixels_for, plain_set, write_image, write_set


def without_colour(folder: Path, *names: str) -> Path:
    """A set whose base colour is gone, and images under other names in its place."""
    plain_set(folder)
    (folder / "base_color.png").unlink()
    for name in names:
        write_image(folder / name, pixels_for("base_color"))
    return folder


@pytest.mark.parametrize(
    "name", ["wood_diffuse_ACEScg.exr", "wood_col_var1.png", "woodcolor.png", "wood_albedo_raw.png"]
)
def test_a_base_colour_is_read_by_its_name(name: str, tmp_path: Path) -> None:
    folder = without_colour(tmp_path, name)
    found = find(folder)
    assert found.maps["base_color"].path == folder / name
    assert not found.warnings


@pytest.mark.parametrize("name", ["wood_clr.png", "wood.png"])
def test_a_base_colour_that_is_not_understood_is_asked_for(name: str, tmp_path: Path) -> None:
    folder = write_set(
        tmp_path, {name: "base_color", "wood_normal_gl.png": "normal", "wood_roughness.png": "roughness"}
    )
    with pytest.raises(InputError) as error:
        find(folder)
    assert f"images without a role: {name}; choose one with --map base_color={name}" in str(error.value)
    assert "base_color=none" in str(error.value)
    assert find(folder, maps={"base_color": name}).maps["base_color"].path == folder / name
    grey = find(folder, maps={"base_color": None})
    assert grey.maps["base_color"].constant == (0.5, 0.5, 0.5)
    assert not any("base colour" in warning for warning in grey.warnings)


def test_a_set_without_any_colour_is_grey_and_that_is_warned_of(tmp_path: Path) -> None:
    (warning,) = find(without_colour(tmp_path)).warnings
    assert "no base colour map: the constant 0.5, 0.5, 0.5 is used, so that what is baked is grey" in warning


def test_an_image_without_a_role_beside_a_missing_metallic_map_is_warned_of(tmp_path: Path) -> None:
    folder = plain_set(tmp_path, mtlns="metallic")
    assert any("no metallic map" in w and "metallic=mtlns.png" in w for w in find(folder).warnings)
    (folder / "mtlns.png").rename(folder / "metallic.png")
    assert not find(folder).warnings


@pytest.mark.parametrize(
    ("stem", "bare", "space"),
    [
        ("wood_diffuse_ACEScg", "wood_diffuse_", "ACEScg"),
        ("woodDiffuseACEScg", "woodDiffuse_", "ACEScg"),
        ("a_col_lin_srgb", "a_col_", LINEAR),
        ("a_BaseColor_Utility - sRGB - Texture", "a_BaseColor_", "sRGB"),
        ("a_BaseColor_Utility - Linear - sRGB", "a_BaseColor_", LINEAR),
        ("a_BaseColor_Utility-Raw", "a_BaseColor_", RAW),
        ("a_ACES - ACES2065-1", "a_", "ACES2065-1"),
        ("a_scene-linear Rec.709-sRGB", "a_", LINEAR),
        ("a_lin_p3d65", "a_", "linear Display P3"),
        ("a_lin_rec2020", "a_", "linear ITU-R BT.2020"),
        ("a_Adobe RGB", "a_", "Adobe RGB (1998)"),
        ("a_Non-Color", "a_", RAW),
        ("raw", "raw", None),
        ("linear_motor_color", "linear_motor_color", None),
    ],
)
def test_colour_spaces_in_names(stem: str, bare: str, space: str | None) -> None:
    assert split_colour_space(stem) == (bare, space)
    if space not in (None, RAW):
        assert canonical_colour_space(space) == space
    for trailing in ("_4k", ".1001", "_2048x2048"):
        assert colour_space_of(stem + trailing) == space


@pytest.mark.parametrize(
    ("name", "pixels", "encoding"),
    [
        ("a_color_lin_srgb.png", np.uint8, LINEAR),
        ("a_color_raw.png", np.uint8, LINEAR),
        ("a_color_linear.png", np.uint8, LINEAR),
        ("a_color_srgb.exr", np.float32, "sRGB"),
        ("a_color_sRGB_2k.png", np.uint8, "sRGB"),
        ("a_color.exr", np.float32, LINEAR),
        ("a_color.png", np.uint8, "sRGB"),
    ],
)
def test_colour_spaces_of_names_are_applied(name: str, pixels: type, encoding: str, tmp_path: Path) -> None:
    folder = without_colour(tmp_path)
    write_image(folder / name, pixels_for("base_color").astype(pixels))
    found = find(folder)
    assert found.maps["base_color"].encoding == encoding
    assert any("its name says" in note for note in found.notes) == (colour_space_of(Path(name).stem) is not None)
    asked = find(folder, colour_space="ACEScg")
    assert asked.maps["base_color"].encoding == "ACEScg"
    assert any("is followed" in warning for warning in asked.warnings) == (colour_space_of(Path(name).stem) is not None)


def test_an_encoding_in_the_name_of_data_is_questioned(tmp_path: Path) -> None:
    folder = plain_set(tmp_path)
    for word, doubted in (("raw", False), ("linear", False), ("sRGB", True)):
        path = (folder / "roughness.png").rename(folder / f"roughness_{word}.png")
        assert any(path.name in warning for warning in find(folder).warnings) == doubted
        path.rename(folder / "roughness.png")


def test_of_variants_the_first_is_taken_and_that_is_said(tmp_path: Path) -> None:
    folder = without_colour(tmp_path, "wood_COL_VAR2_4K.png", "wood_COL_VAR1_4K.png")
    found = find(folder)
    assert found.maps["base_color"].path == folder / "wood_COL_VAR1_4K.png"
    assert "base_color: wood_COL_VAR1_4K.png is preferred to wood_COL_VAR2_4K.png" in found.notes


@pytest.mark.parametrize("stem", ["gunmetal", "unsmooth", "Metal007", "bitmask", "bold", "Ambrosia", "encore", "bump2"])
def test_words_that_merely_end_alike_say_no_role(stem: str) -> None:
    assert interpretations(stem) == []


def test_a_name_that_says_it_clearly_is_preferred_to_a_glued_word(tmp_path: Path) -> None:
    folder = plain_set(tmp_path, watercolor="base_color")
    assert find(folder).maps["base_color"].path == folder / "base_color.png"


def test_sets_whose_words_are_all_glued(tmp_path: Path) -> None:
    files = {"woodcolor.png": "base_color", "woodnormalgl.png": "normal", "woodroughness.png": "roughness"}
    found = find(write_set(tmp_path, files))
    assert {s.path.name for s in found.maps.values() if s.path} == set(files)
    assert found.normal_convention.decided_by == "name"


def test_names_that_end_in_the_workflow() -> None:
    """Poliigon has such names."""
    stems = [f"Tiles001_{word}_2K_METALNESS" for word in ("COL_VAR1", "NRM", "ROUGHNESS", "METALNESS")]
    roles = [match and match.meanings[0].role for match in classify(stems)]
    assert roles == ["base_color", "normal", "roughness", "metallic"]
    assert classify(["Metal007_1K_Metalness"])[0].meanings[0].role == "metallic"


AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)


@pytest.mark.parametrize(
    ("name", "attributes", "encoding"),
    [
        ("a_color.exr", {"chromaticities": AP1}, "ACEScg"),
        ("a_color.exr", {"chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)}, LINEAR),
        ("a_color.exr", {"chromaticities": (0.6, 0.3, 0.3, 0.6, 0.2, 0.1, 0.3, 0.3)}, LINEAR),
        ("a_color.exr", {"oiio__ColorSpace": "sRGB"}, "sRGB"),
        ("a_color_lin_srgb.exr", {"chromaticities": AP1}, LINEAR),
    ],
)
def test_colour_spaces_that_exr_files_tell(name: str, attributes: dict, encoding: str, tmp_path: Path) -> None:
    import OpenImageIO as oiio  # noqa: N813

    folder = without_colour(tmp_path)
    spec = oiio.ImageSpec(8, 8, 3, "half")
    for key, value in attributes.items():
        kind = "string" if isinstance(value, str) else "float[8]"
        spec.attribute(key.replace("__", ":"), oiio.TypeDesc(kind), value)
    output = oiio.ImageOutput.create(str(folder / name))
    assert output.open(str(folder / name), spec) and output.write_image(np.full((8, 8, 3), 0.5, np.float32))
    output.close()
    assert find(folder).maps["base_color"].encoding == encoding


@pytest.mark.parametrize("name", COLOUR_SPACES)
def test_values_are_those_of_colour_science(name: str) -> None:
    library = colour_science("a test")
    space = library.RGB_COLOURSPACES[name]
    rec709 = library.RGB_COLOURSPACES["ITU-R BT.709"]
    own = COLOUR_SPACES[name]
    matrix = library.matrix_RGB_to_RGB(space, rec709, "Bradford")
    np.testing.assert_allclose(own.to_rec709, matrix, rtol=0, atol=1e-12)
    values = np.linspace(0, 1.2, 4001)
    linear = values if own.decoded is None else own.decoded(values)
    np.testing.assert_allclose(linear, space.cctf_decoding(values), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", COLOUR_SPACES)
def test_colour_science_is_not_asked_for_them(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(user: str) -> None:
        raise UsageError(user)

    monkeypatch.setattr(colour, "colour_science", asked)
    for spelt in (name, name.lower(), f"linear {name}"):
        space = canonical_colour_space(spelt)
        grey = decode(np.full((1, 1, 3), 255, np.uint8), space)
        np.testing.assert_allclose(grey, grey.mean(), rtol=1e-4)
    with pytest.raises(UsageError, match="'ProPhoto RGB', which mipbake does not know itself"):
        canonical_colour_space("ProPhoto RGB")
