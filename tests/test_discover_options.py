"""Finding the maps of a set where options say which is which."""

from __future__ import annotations

from pathlib import Path

import pytest

from mipbake.base.errors import InputError, UsageError
from mipbake.source.options import LoadOptions

from .input_files import find, pixels_for, plain_set, write_image, write_set


def test_options_fill_roles(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set", {"a.png": "normal", "b.png": "packed_alpha", "c_normal.png": "normal"})
    write_image(tmp_path / "elsewhere.png", pixels_for("height", 16))
    maps = {
        "normal": "a.png",
        "roughness": "b.png:g",
        "metallic": 1,
        "opacity": "b.png:A",
        "height": tmp_path / "elsewhere.png",
        "base_color": 0.25,
    }
    found = find(folder, maps=maps, normal_convention="opengl")
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
    found = find(tmp_path, maps={"roughness": "orm.png"})
    assert found.maps["roughness"].channels == "G"
    found = find(tmp_path, maps={"roughness": "gloss.png"})
    assert found.maps["roughness"].inverted
    (tmp_path / "gloss.png").rename(tmp_path / "metal_rough.png")
    found = find(tmp_path, maps={"roughness": "metal_rough.png", "metallic": 0})
    assert found.maps["roughness"].channels == "Y"
    (tmp_path / "metal_rough.png").rename(tmp_path / "gloss.png")
    found = find(tmp_path, maps={"roughness": "gloss.png"}, roughness_is_gloss=False)
    assert not found.maps["roughness"].inverted
    assert find(tmp_path, roughness_is_gloss=True).maps["roughness"].inverted


def test_left_out_maps_become_constants_or_disappear(tmp_path: Path) -> None:
    plain_set(tmp_path, metallic="metallic", ao="occlusion")
    found = find(tmp_path, maps={"normal": None, "metallic": None, "occlusion": None})
    assert found.maps["normal"].constant == (0, 0, 1)
    assert found.normal_convention.decided_by == "flat"
    assert found.maps["metallic"].constant == (0,)
    assert "occlusion" not in found.maps
    assert any("no metallic map" in n for n in found.notes)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"maps": {"rust": "a.png"}}, "unknown map 'rust'.*roughness"),
        ({"maps": {"roughness": 1.5}}, "from 0 to 1"),
        ({"maps": {"height": float("nan")}}, "height is nan: expected a finite number or a file$"),
        ({"maps": {"height": float("-inf")}}, "height is -inf: expected a finite number or a file$"),
        ({"maps": {"metallic": float("inf")}}, "metallic is inf: expected a number from 0 to 1"),
        ({"maps": {"roughness": None}}, "cannot be left out"),
        ({"maps": {"normal": 0.5}}, "cannot be the number"),
        ({"maps": {"metallic": True}}, "expected a file, a number or None"),
        ({"normal_convention": "vulkan"}, "opengl, directx"),
        ({"wrap": ("wrap", "mirror")}, "wrap, clamp"),
        ({"wrap": "wrap"}, "two modes"),
    ],
)
def test_impossible_options_are_refused(arguments: dict[str, object], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        LoadOptions(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("maps", "match"),
    [
        ({"roughness": "gone.png"}, "no such file"),
        ({"roughness": "roughness.png:B"}, "no channel B"),
        ({"opacity": "base_color.png:A"}, "no channel A"),
    ],
)
def test_options_that_name_what_is_not_there_are_refused(maps: dict[str, str], match: str, tmp_path: Path) -> None:
    plain_set(tmp_path)
    with pytest.raises(InputError, match=match):
        find(tmp_path, maps=maps)
    with pytest.raises(UsageError, match="expected 1 of"):
        find(tmp_path, maps={"roughness": "base_color.png:RG"})
