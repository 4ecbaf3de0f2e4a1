"""Loading texture sets: what every role is decoded to, and what is said about it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake.base.errors import InputError, UsageError
from mipbake.base.srgb import srgb_to_linear
from mipbake.material import MODELS
from mipbake.source.decode import upsample
from mipbake.source.loading import load
from mipbake.source.texture_set import TextureSet

from .input_files import bytes_of, encoded, height_field, pixels_for, plain_set, write_image, write_set


def test_a_complete_set_is_decoded(tmp_path: Path) -> None:
    stems = ("metallic", "occlusion", "height", "emissive", "opacity")
    folder = plain_set(tmp_path / "old wall (2)", **{s: s for s in stems})
    result = load(folder)
    assert (result.name, result.width, result.height) == ("old_wall_2", 32, 32)
    for role, texture in result.maps.items():
        stem = "normal_gl" if role == "normal" else role
        pixels = pixels_for(role)
        if role == "normal":
            expected = pixels / 127.5 - 1
            expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
        else:
            expected = srgb_to_linear(pixels / 255) if role in ("base_color", "emissive") else pixels / 255
        np.testing.assert_allclose(texture.pixels, expected, atol=1e-6)
        assert texture.pixels.dtype == np.float32
        assert texture.source.path == folder / f"{stem}.png"
        assert (texture.source.depth, len(texture.source.sha256)) == ("uint8", 64)
    assert list(result.plain_maps) == ["occlusion", "height", "emissive", "opacity"]
    assert result.warnings == ()


@pytest.mark.parametrize(
    ("suffix", "depth", "is_srgb"),
    [*(("tga", "uint8", True), ("png", "uint16", True), ("tif", "float", False), ("exr", "half", False))],
)
def test_every_stored_type_means_the_same_values(suffix: str, depth: str, is_srgb: bool, tmp_path: Path) -> None:
    values = np.random.default_rng(0).uniform(0.05, 0.95, (16, 16, 3))
    folder = plain_set(tmp_path, normal_gl=encoded(height_field(16, 16)))
    for stem, channels in (("base_color", 3), ("roughness", 1)):
        (folder / f"{stem}.png").unlink()
        stored = {"uint8": bytes_of(values), "uint16": bytes_of(values, 65535)}.get(depth, values.astype(np.float32))
        write_image(folder / f"{stem}.{suffix}", stored[..., : 3 if suffix == "tga" else channels], depth)
    result = load(folder)
    tolerance = {"uint8": 0.6 / 255, "half": 3e-4}.get(depth, 1e-5) * (2.3 if is_srgb else 1)
    colour = srgb_to_linear(values) if is_srgb else values
    np.testing.assert_allclose(result.maps["base_color"].pixels, colour, atol=tolerance)
    np.testing.assert_allclose(result.maps["roughness"].pixels, values[..., :1], atol=tolerance)


@pytest.mark.parametrize(
    ("name", "space", "linear"),
    [("ACEScg", "ACEScg", True), ("display p3", "Display P3", False), ("ITU-R BT.2020", "ITU-R BT.2020", True)],
)
def test_colour_spaces_become_linear_rec709(name: str, space: str, linear: bool, tmp_path: Path) -> None:
    import colour

    wanted = np.random.default_rng(0).uniform(0.2, 0.6, (16, 16, 3))
    rgb = colour.RGB_COLOURSPACES
    stored = colour.RGB_to_RGB(wanted, rgb["ITU-R BT.709"], rgb[space], "Bradford", apply_cctf_encoding=not linear)
    folder = plain_set(tmp_path, normal_gl=encoded(height_field(16, 16)), roughness=pixels_for("roughness", 16))
    write_image(folder / "base_color.png", bytes_of(stored, 65535))
    result = load(folder, colour_space=f"linear {name}" if linear else name)
    np.testing.assert_allclose(result.maps["base_color"].pixels, wanted, atol=2e-4)
    assert result.maps["roughness"].source.encoding == "data"


def test_colours_outside_rec709_are_clipped_and_counted(tmp_path: Path) -> None:
    pixels = np.full((32, 32, 3), 128, np.uint8)
    pixels[:2, :4] = (0, 255, 0)
    folder = plain_set(tmp_path, base_color=pixels, emissive=pixels)
    result = load(folder, colour_space="Display P3")
    base, emissive = result.maps["base_color"].pixels, result.maps["emissive"].pixels
    assert (base.min(), base.max()) == (0, 1)
    assert any(n.startswith("base_color.png: 8 texels outside [0, 1] in linear Rec.709 clipped") for n in result.notes)
    assert emissive.min() == 0 and emissive.max() > 1  # light may be brighter than white
    assert any(n.startswith("emissive.png: 8 texels below 0 in linear Rec.709 clipped (from -0.") for n in result.notes)


def test_values_outside_the_range_of_a_role_are_clipped_questioned_or_refused(tmp_path: Path) -> None:
    folder = plain_set(tmp_path, metallic=np.eye(32, dtype=np.uint8))
    assert any("its values are 0 and 1 of 255" in warning for warning in load(folder).warnings)
    (folder / "roughness.png").unlink()
    (folder / "metallic.png").unlink()
    values = np.full((32, 32), 0.5, np.float32)
    values[3, 4], values[5, 6] = -0.25, 1.5
    write_image(folder / "roughness.exr", values, "float")
    values[:4] = 1.25
    write_image(folder / "metallic.exr", values, "float")
    result = load(folder)
    assert result.maps["roughness"].pixels[[3, 5, 0], [4, 6, 0], 0].tolist() == [0, 1, 0.5]
    assert any("roughness.exr: 2 texels outside [0, 1] clipped (from -0.25 to 1.5)" in n for n in result.notes)
    told = "metallic.exr: 129 texels outside [0, 1] clipped (from 0.5 to 1.5), 13% of all: check that it is a map of"
    assert any(told in warning for warning in result.warnings)
    (folder / "roughness.exr").unlink()
    write_image(folder / "gloss.exr", pixels_for("roughness").astype(np.float32), "float")
    with pytest.raises(InputError, match=r"gloss\.exr holds values from \d+ to \d+: expected roughness from 0 to 1"):
        load(folder)


def test_grey_colours_alpha_and_grey_directions(tmp_path: Path) -> None:
    grey, rgba = pixels_for("roughness"), pixels_for("packed_alpha")
    uneven = (grey + np.random.default_rng(0).integers(0, 2, (32, 32, 3))).astype(np.uint8)
    result = load(plain_set(tmp_path / "grey", base_color=grey, anisotropy=uneven))
    colour = srgb_to_linear(np.repeat(grey, 3, -1) / 255)
    np.testing.assert_allclose(result.maps["base_color"].pixels, colour, atol=1e-6)
    np.testing.assert_array_equal(result.maps["anisotropy"].pixels[..., :2], np.broadcast_to([1, 0], (32, 32, 2)))
    np.testing.assert_allclose(result.maps["anisotropy"].pixels[..., 2:], grey / 255, atol=1.1 / 255)
    assert "anisotropy.png: it is grey, and is taken as the strength along +X" in result.notes
    result = load(plain_set(tmp_path / "alpha", base_color=rgba))
    np.testing.assert_allclose(result.maps["base_color"].pixels, srgb_to_linear(rgba[..., :3] / 255), atol=1e-6)
    np.testing.assert_allclose(result.maps["opacity"].pixels, rgba[..., 3:] / 255, atol=1e-6)
    assert any("opacity is the alpha channel" in n for n in result.notes)


def test_maps_that_do_not_shade_are_never_altered(tmp_path: Path) -> None:
    folder = plain_set(tmp_path)
    height = np.random.default_rng(0).normal(size=(8, 4, 1)).astype(np.float32) * 10
    emissive = np.random.default_rng(1).random((64, 64, 3)).astype(np.float32) * 100
    write_image(folder / "height.exr", height, "float")
    write_image(folder / "emissive.exr", emissive, "float")
    result = load(folder)
    np.testing.assert_array_equal(result.maps["height"].pixels, height)
    np.testing.assert_array_equal(result.maps["emissive"].pixels, emissive)
    assert (result.width, result.height) == (32, 32)


def test_gloss_is_inverted_and_packed_channels_are_taken(tmp_path: Path) -> None:
    packed = pixels_for("packed_alpha")
    files = {"a_baseColor.png": "base_color", "a_normal_gl.png": "normal"}
    result = load(write_set(tmp_path / "unity", files | {"a_MetallicSmoothness.png": packed}))
    np.testing.assert_allclose(result.maps["metallic"].pixels[..., 0], packed[..., 0] / 255, atol=1e-6)
    np.testing.assert_allclose(result.maps["roughness"].pixels[..., 0], 1 - packed[..., 3] / 255, atol=1e-6)
    assert any("gloss, which is inverted" in n for n in result.notes)
    result = load(write_set(tmp_path / "orm", files | {"a_orm.png": packed[..., :3].copy()}))
    for role, channel in (("occlusion", 0), ("roughness", 1), ("metallic", 2)):
        np.testing.assert_allclose(result.maps[role].pixels[..., 0], packed[..., channel] / 255, atol=1e-6)
    explicit = {"roughness": "a_orm.png:B", "metallic": "a_orm.png:R"}
    result = load(tmp_path / "orm", maps=explicit, roughness_is_gloss=True)
    np.testing.assert_allclose(result.maps["roughness"].pixels[..., 0], 1 - packed[..., 2] / 255, atol=1e-6)
    np.testing.assert_allclose(result.maps["metallic"].pixels[..., 0], packed[..., 0] / 255, atol=1e-6)


def test_a_coloured_roughness_map_is_questioned(tmp_path: Path) -> None:
    grey = np.repeat(pixels_for("roughness"), 3, -1)
    assert load(plain_set(tmp_path / "grey", roughness=grey)).warnings == ()
    coloured = load(plain_set(tmp_path / "coloured", roughness="packed"))
    assert any("roughness.png: its channels differ" in w for w in coloured.warnings)


@pytest.mark.parametrize(("stem", "choice"), [("a_rma", None), ("a_rmo", None), ("roughness", "roughness.png:R")])
def test_a_channel_that_was_asked_for_is_not_questioned(stem: str, choice: str | None, tmp_path: Path) -> None:
    write_set(tmp_path, {"a_base_color.png": "base_color", "a_normal_gl.png": "normal", f"{stem}.png": "packed"})
    result = load(tmp_path, maps={} if choice is None else {"roughness": choice})
    assert (result.maps["roughness"].source.path, result.maps["roughness"].source.channels) == (
        tmp_path / f"{stem}.png",
        "R",
    )
    assert result.warnings == ()


def test_anisotropy_is_direction_and_strength(tmp_path: Path) -> None:
    angle = np.linspace(0, 2 * np.pi, 32 * 32).reshape(32, 32)
    strength = np.linspace(0, 1, 32 * 32).reshape(32, 32).T
    direction = np.stack([np.cos(angle), np.sin(angle)], -1)
    pixels = bytes_of(np.concatenate([direction / 2 + 0.5, strength[..., None]], -1))
    pixels[0, 0] = (128, 128, 200)
    result = load(plain_set(tmp_path / "a", anisotropy=pixels))
    assert result.anisotropic
    assert result.source_model == "gltf-anisotropic"
    stored = result.material("gltf-anisotropic")
    np.testing.assert_allclose(stored[1:, :, 8:10], direction[1:], atol=0.01)
    np.testing.assert_allclose(stored[1:, :, 10], strength[1:], atol=0.005)
    np.testing.assert_allclose(stored[0, 0, 8:], (1, 0, 200 / 255), atol=1e-6)
    result = load(plain_set(tmp_path / "b", anisotropy=pixels_for("roughness")))
    assert (result.maps["anisotropy"].pixels[..., :2] == (1, 0)).all()


def test_missing_maps_are_constants_and_that_is_said(tmp_path: Path) -> None:
    folder = plain_set(tmp_path)
    (folder / "base_color.png").unlink()
    result = load(folder, maps={"roughness": 0.25, "normal": None})
    assert (result.width, result.height) == (1, 1)
    result = load(folder, maps={"roughness": 0.25})
    assert result.maps["base_color"].pixels.shape == (32, 32, 3)
    assert (result.maps["base_color"].pixels == 0.5).all()
    assert (result.maps["metallic"].pixels == 0).all()
    assert (result.maps["roughness"].pixels == 0.25).all()
    assert any(n.startswith("no metallic map: the constant") for n in result.notes)
    assert any(w.startswith("no base colour map: the constant") and "base_color=none" in w for w in result.warnings)
    result = load(folder, maps={"roughness": 0.25, "base_color": None})
    assert not result.warnings and any(n.startswith("no base colour map: the constant") for n in result.notes)


def test_smaller_maps_are_resampled_to_the_largest(tmp_path: Path) -> None:
    small = np.arange(16, dtype=np.uint8).reshape(4, 4, 1) * 16
    folder = plain_set(
        tmp_path, roughness=small, base_color=pixels_for("base_color", 1), normal_gl=encoded(height_field(8, 8))
    )
    write_image(folder / "metallic.png", pixels_for("metallic", 16))
    result = load(folder)
    assert (result.width, result.height) == (16, 16)
    np.testing.assert_allclose(
        result.maps["roughness"].pixels, upsample(small / np.float32(255), 16, 16, ("wrap", "wrap")), atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(result.maps["normal"].pixels, axis=-1), 1, atol=1e-5)
    assert np.ptp(result.maps["base_color"].pixels.reshape(-1, 3), axis=0).max() == 0
    assert sum("resampled" in n for n in result.notes) == 2
    assert result.material("gltf").shape == (16, 16, 8)
    assert not np.array_equal(load(folder, wrap=("clamp", "wrap")).material("gltf"), result.material("gltf"))


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 4), st.booleans(), st.booleans(), st.data())
def test_resampling_is_bilinear_between_texel_centres(rows, columns, factor, wrap_u, wrap_v, data):
    width, height = columns * factor, rows * factor
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    pixels = rng.random((rows, columns, 2)).astype(np.float32)
    modes = ("wrap" if wrap_u else "clamp", "wrap" if wrap_v else "clamp")
    result = upsample(pixels, width, height, modes)
    assert result.shape == (height, width, 2)
    row, column = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    y, x = (row + 0.5) / factor - 0.5, (column + 0.5) / factor - 0.5
    expected = np.zeros(2)
    for i in (int(np.floor(y)), int(np.floor(y)) + 1):
        for j in (int(np.floor(x)), int(np.floor(x)) + 1):
            weight = (1 - abs(y - i)) * (1 - abs(x - j))
            at_row = i % rows if wrap_v else min(max(i, 0), rows - 1)
            at_column = j % columns if wrap_u else min(max(j, 0), columns - 1)
            expected += weight * pixels[at_row, at_column]
    np.testing.assert_allclose(result[row, column], expected, atol=1e-5)
    if wrap_u and wrap_v:
        np.testing.assert_allclose(result.mean((0, 1)), pixels.mean((0, 1)), atol=1e-5)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 40), (7, 33)])
def test_any_size_and_shape(height: int, width: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for stem, pixels in {
        "base_color": rng.integers(0, 256, (height, width, 3)).astype(np.uint8),
        "normal_gl": encoded(np.broadcast_to([0.0, 0, 1], (height, width, 3))),
        "roughness": rng.integers(0, 256, (height, width, 1)).astype(np.uint8),
    }.items():
        write_image(tmp_path / f"{stem}.png", pixels)
    result = load(tmp_path)
    for model in MODELS:
        stored = result.material(model)
        assert stored.shape == (height, width, MODELS[model].channels)
        assert stored.dtype == np.float32
        assert stored.flags.c_contiguous
        assert np.isfinite(stored).all()


def test_the_source_hash_is_that_of_the_pixels(tmp_path: Path) -> None:
    folder = plain_set(tmp_path / "a")
    first = load(folder)
    assert load(folder).source_hash == first.source_hash
    assert load(plain_set(tmp_path / "b")).source_hash == first.source_hash
    assert load(folder, wrap=("clamp", "clamp")).source_hash != first.source_hash
    assert load(folder, normal_convention="directx").source_hash != first.source_hash
    assert load(folder, maps={"metallic": 1}).source_hash != first.source_hash
    assert load(folder, alpha_cutoff=0.5).source_hash == first.source_hash  # of levels alone
    write_image(folder / "roughness.png", pixels_for("roughness")[::-1].copy())
    assert load(folder).source_hash != first.source_hash


@pytest.mark.parametrize("anisotropic", [False, True])
def test_level_0_is_the_maps_themselves(tmp_path: Path, anisotropic: bool) -> None:
    """Copies of it would be as large as all maps that shade: they lie in one array, in the order of the model."""
    strength = np.full((32, 32), 99, np.uint8)  # grey, along +X: signs that agree
    folder = plain_set(tmp_path / "wall", **({"anisotropy": strength} if anisotropic else {}))
    result = load(folder)
    stored = result.material(result.source_model)
    maps = [result.maps[role].pixels for role in ("base_color", "metallic", "roughness", "normal")]
    maps += [result.maps["anisotropy"].pixels] if anisotropic else []
    np.testing.assert_array_equal(stored, np.concatenate(maps, -1))
    assert stored.flags.c_contiguous and np.shares_memory(stored, maps[0])
    other = replace(result, maps={**result.maps, "metallic": replace(result.maps["metallic"], pixels=maps[1].copy())})
    apart = other.material(result.source_model)
    assert not np.shares_memory(apart, maps[0])
    np.testing.assert_array_equal(apart, stored)


# ---- from arrays


def arrays(**others: Any) -> dict[str, Any]:
    """Arguments of from_arrays for a small set."""
    rng = np.random.default_rng(0)
    return {
        "normal": height_field(8, 12),
        "roughness": rng.random((8, 12)),
        "base_color": rng.random((8, 12, 3)),
    } | others


def test_sets_are_made_from_arrays() -> None:
    given_arrays = arrays(metallic=1.0, anisotropy=np.full((8, 12, 3), (0, 2, 0.5)), height=np.ones((4, 4)) * 7)
    result = TextureSet.from_arrays("brass", wrap=("clamp", "wrap"), **given_arrays)
    assert (result.name, result.width, result.height, result.wrap) == ("brass", 12, 8, ("clamp", "wrap"))
    stored = result.material("gltf-anisotropic")
    np.testing.assert_allclose(stored[..., :3], given_arrays["base_color"], atol=1e-6)
    np.testing.assert_allclose(stored[..., 4], given_arrays["roughness"], atol=1e-6)
    np.testing.assert_allclose(stored[..., 5:8], given_arrays["normal"], atol=1e-6)
    assert (stored[..., 3] == 1).all()
    np.testing.assert_allclose(stored[..., 8:], np.broadcast_to([0, 1, 0.5], (8, 12, 3)))
    assert result.maps["height"].pixels.shape == (4, 4, 1)
    assert result.convention.name == "opengl"
    given_arrays["roughness"][:] = 0  # which was copied
    assert result.maps["roughness"].pixels.min() > 0
    plain = TextureSet.from_arrays("brass", **arrays())
    assert not plain.anisotropic
    grey = TextureSet.from_arrays("grey", **arrays(base_color=np.full((8, 12), 0.25)))
    assert (grey.maps["base_color"].pixels == np.full((8, 12, 3), 0.25)).all()
    assert plain.source_hash != result.source_hash
    assert plain.source_hash == TextureSet.from_arrays("brass", **arrays()).source_hash


@pytest.mark.parametrize(
    ("others", "match"),
    [
        ({"roughness": np.full((8, 12), 1.5)}, r"roughness runs from 1\.5 to 1\.5"),
        ({"roughness": np.full((8, 12), np.nan)}, "roughness holds 96 NaN"),
        ({"roughness": np.ones((8, 12, 3))}, r"roughness has shape \(8, 12, 3\)"),
        ({"roughness": np.ones((8, 8))}, "roughness is 8 x 8 and the largest map is 12 x 8"),
        ({"roughness": np.full((8, 12), 200, np.uint8)}, "roughness holds integers up to .*values / 255$"),
        ({"base_color": np.full((8, 12, 3), 200, np.uint8)}, "base_color holds integers .*decoded from sRGB$"),
        ({"normal": height_field(8, 12) * [1, 1, -1]}, "points into the surface"),
        ({"normal": 0.5}, r"normal has shape \(\)"),
        ({"emissive": np.full((8, 12, 3), -1.0)}, "emissive runs from -1"),
        ({"normal": (height_field(8, 12) + 1) / 2}, "normal is encoded in 0 to 1.*signed vectors, pass 2"),
        ({"normal": bytes_of((height_field(8, 12) + 1) / 2)}, "normal is encoded in 0 to 255,.*pass 2"),
        ({"anisotropy": np.full((8, 12, 3), (0.5, 1, 1))}, r"anisotropy is encoded .*values - 1 for x and y"),
    ],
)
def test_arrays_that_are_no_texture_set_are_refused(others: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        TextureSet.from_arrays("a", **arrays(**others))
    with pytest.raises(UsageError, match="wrap"):
        TextureSet.from_arrays("a", wrap=("wrap", "mirror"), **arrays())


@pytest.mark.parametrize("normal", [[[[0, 0, 1]]], [[[0.6, 0, 0.8]]], height_field(16, 16) * 3])
def test_signed_normals_of_any_length_pass(normal: Any) -> None:
    made = TextureSet.from_arrays("a", normal=normal, roughness=0.5, metallic=np.eye(1, dtype=np.uint8))
    np.testing.assert_allclose(np.linalg.norm(made.maps["normal"].pixels, axis=-1), 1, atol=1e-5)
    assert made.maps["metallic"].pixels.max() == 1
