"""Base colours that nobody's list of names holds, colour spaces in names, and what colour spaces are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mipbake.base import colour
from mipbake.base.colour import LINEAR, canonical_colour_space, decode
from mipbake.base.colour_science import colour_science
from mipbake.base.colour_spaces import COLOUR_SPACES
from mipbake.base.errors import InputError, UsageError
from mipbake.source.images.colours import RAW, split_colour_space
from mipbake.source.names import colour_space_of

from .input_files import find, pixels_for, plain_set, write_image, write_set


def without_colour(folder: Path, *names: str) -> Path:
    """A set whose base colour is gone, and images under other names in its place."""
    plain_set(folder)
    (folder / "base_color.png").unlink()
    for name in names:
        write_image(folder / name, pixels_for("base_color"))
    return folder


@pytest.mark.parametrize("name", ["wood_diffuse_ACEScg.exr", "wood_col_var1.png", "woodcolor.png"])
def test_a_base_colour_is_read_by_its_name(name: str, tmp_path: Path) -> None:
    found = find(without_colour(tmp_path, name))
    assert found.maps["base_color"].path == tmp_path / name and not found.warnings


@pytest.mark.parametrize("name", ["wood_clr.png", "wood.png"])
def test_a_base_colour_that_is_not_understood_has_to_be_chosen(name: str, tmp_path: Path) -> None:
    names = {name: "base_color", "wood_normal_gl.png": "normal", "wood_roughness.png": "roughness"}
    folder = write_set(tmp_path, names)
    with pytest.raises(InputError, match=rf"images without a role: {name}; choose one with .*base_color=none"):
        find(folder)
    assert find(folder, maps={"base_color": name}).maps["base_color"].path == folder / name
    grey = find(folder, maps={"base_color": None})
    assert grey.maps["base_color"].constant == (0.5, 0.5, 0.5)
    assert not any("base colour" in warning for warning in grey.warnings)


def test_maps_that_may_be_missing_are_warned_of(tmp_path: Path) -> None:
    (warning,) = find(without_colour(tmp_path / "a")).warnings
    assert "no base colour map: the constant 0.5, 0.5, 0.5 is used, so that what is baked is grey" in warning
    folder = plain_set(tmp_path / "b", mtlns="metallic")
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


def test_sixteen_bit_colours_are_srgb_and_that_is_said(tmp_path: Path) -> None:
    plain_set(tmp_path)
    write_image(tmp_path / "base_color.png", np.full((32, 32, 3), 30000, np.uint16))
    found = find(tmp_path)
    assert found.maps["base_color"].encoding == "sRGB"
    assert any("uint16 values are taken as sRGB" in n for n in found.notes)


def test_sets_whose_words_are_all_glued(tmp_path: Path) -> None:
    files = {"woodcolor.png": "base_color", "woodnormalgl.png": "normal", "woodroughness.png": "roughness"}
    found = find(write_set(tmp_path, files))
    assert {s.path.name for s in found.maps.values() if s.path} == set(files)
    assert found.normal_convention.decided_by == "name"


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


def test_colour_science_is_not_needed_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def asked(user: str) -> None:
        raise UsageError(user)

    monkeypatch.setattr(colour, "colour_science", asked)
    for spelt in (spelt for name in COLOUR_SPACES for spelt in (name.lower(), f"linear {name}")):
        grey = decode(np.full((1, 1, 3), 255, np.uint8), canonical_colour_space(spelt))
        np.testing.assert_allclose(grey, grey.mean(), rtol=1e-4)
    with pytest.raises(UsageError, match="'ProPhoto RGB', which mipbake does not know itself"):
        canonical_colour_space("ProPhoto RGB")
