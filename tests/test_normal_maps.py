"""Normal maps: the curl test, what is refused as no normal map, holes, and no specks in what is baked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mipbake
from mipbake import shading
from mipbake.baking.adjust import Adjustments, adjusted
from mipbake.baking.methods import METHODS
from mipbake.base.errors import InputError
from mipbake.material import MIN_NORMAL_Z
from mipbake.quality.metrics.pairs import pair_set
from mipbake.source.loading import load
from mipbake.source.normal import DECIDED_CONFIDENCE, decode_normals, held, integrability, normalised, tiles
from mipbake.source.texture_set import TextureSet

from .input_files import bytes_of, encoded, height_field, pixels_for, plain_set, write_image
from .quick_methods import NONE, quick_methods

FLIP = np.array([1, -1, 1], np.float32)


HERE = Path("normal.png")


def decoded(pixels: np.ndarray) -> np.ndarray:
    return decode_normals(pixels, HERE)[0]


@settings(max_examples=30, deadline=None)
@given(st.integers(24, 300), st.integers(24, 300), st.integers(0, 2**32 - 1), st.floats(0.05, 1.5), st.booleans())
def test_height_fields_tell_their_convention(height: int, width: int, seed: int, steep: float, directx: bool) -> None:
    field = height_field(height, width, seed, steep)
    convention, confidence = integrability(tiles(decoded(encoded(field, directx))))
    assert convention == ("directx" if directx else "opengl") and confidence >= DECIDED_CONFIDENCE


def test_compression_noise_does_not_hide_the_convention(tmp_path: Path) -> None:
    for name, directx in (("opengl", False), ("directx", True)):
        pixels = encoded(height_field(256, 256, steepness=0.15), directx)
        path = write_image(tmp_path / f"{name}_normal.jpg", pixels, CompressionQuality=70)
        found = load([path], maps={"roughness": 0.5})
        assert (found.convention.name, found.convention.decided_by) == (name, "pixels")


@pytest.mark.parametrize("size", [(1, 1), (1, 64), (3, 3), (256, 256)])
def test_noise_and_flatness_are_not_decided(size: tuple[int, int]) -> None:
    up = np.array([0, 0, 1], np.float32)
    assert integrability(tiles(np.broadcast_to(up, (*size, 3))))[1] == 0
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=(*size, 3)).astype(np.float32) * 0.2
        assert integrability(tiles(normalised(noise + up)))[1] < (0.3 if min(size) >= 100 else 1)


def test_a_silent_name_is_decided_by_pixels_and_green_ends_up(tmp_path: Path) -> None:
    field = height_field(64, 64)
    for directx in (False, True):
        path = write_image(tmp_path / f"{directx}_normal.png", encoded(field, directx))
        result = load([path], maps={"roughness": 0.5})
        convention = result.convention
        assert (convention.name, convention.decided_by) == ("directx" if directx else "opengl", "pixels")
        assert convention.confidence > 0.99 and any("by the curl of its slopes" in n for n in result.notes)
        np.testing.assert_allclose(result.maps["normal"].pixels, field, atol=0.01)


def test_what_cannot_be_seen_is_assumed_with_a_warning(tmp_path: Path) -> None:
    slope = np.broadcast_to(0.5 * np.sin(np.arange(32) / 3), (32, 32))
    waves = np.stack([slope, np.zeros((32, 32)), np.ones((32, 32))], -1)
    path = write_image(tmp_path / "normal.png", encoded(waves / np.linalg.norm(waves, axis=-1, keepdims=True)))
    result = load([path], maps={"roughness": 0.5})
    assert (result.convention.name, result.convention.decided_by) == ("opengl", "assumed")
    assert any("OpenGL is assumed" in w for w in result.warnings)
    flat = np.full((320, 320, 3), (128, 128, 255), np.uint8)
    result = load([write_image(path, flat)], maps={"roughness": 0.5, "base_color": None})
    assert (result.convention.name, result.convention.decided_by) == ("opengl", "flat") and result.warnings == ()
    flat[77, 199, :2] = 180  # one dent: now there is something to see
    assert load([write_image(path, flat)], maps={"roughness": 0.5}).convention.decided_by == "assumed"


def test_the_option_and_the_name_win_over_pixels_and_contradictions_are_said(tmp_path: Path) -> None:
    field = height_field(64, 64)
    folder = plain_set(tmp_path, roughness=pixels_for("roughness", 64), base_color=pixels_for("base_color", 64))
    write_image(folder / "normal_gl.png", encoded(field, directx=True))
    result = load(folder)
    assert (result.convention.name, result.convention.decided_by) == ("opengl", "name")
    assert any("its name says OpenGL, but the curl" in w for w in result.warnings)
    np.testing.assert_allclose(result.maps["normal"].pixels, field * FLIP, atol=0.01)
    result = load(folder, normal_convention="directx")
    assert (result.convention.name, result.convention.decided_by) == ("directx", "option")
    np.testing.assert_allclose(result.maps["normal"].pixels, field, atol=0.01)
    assert any("the option says DirectX" in w for w in result.warnings)


@pytest.mark.parametrize("value", [(0, 0, 0), (128, 128, 128), (200, 128, 230)])
def test_constant_maps_other_than_flat_are_refused(value: tuple[int, int, int]) -> None:
    with pytest.raises(InputError, match=r"normal\.png is constant at"):
        decoded(np.full((16, 16, 3), value, np.uint8))


def test_heights_and_colours_are_refused() -> None:
    rng = np.random.default_rng(0)
    smooth = bytes_of(height_field(64, 64)[..., :1] * 0.4 + 0.6)
    with pytest.raises(InputError, match="one channel"):
        decoded(smooth)
    with pytest.raises(InputError, match="height map"):
        decoded(np.repeat(smooth, 3, -1))
    noise = rng.random((64, 64, 3))
    with pytest.raises(InputError, match="colour map"):
        decoded(bytes_of(noise))
    shade = rng.random((64, 64, 1))
    for tint in ([0.6, 0.3, 0.2], [0.3, 0.5, 0.2], [0.9, 0.8, 0.7], [0.2, 0.3, 0.6]):
        with pytest.raises(InputError, match=r"normal map|rise and fall together"):
            decoded(bytes_of(0.1 + shade * np.array(tint) + 0.03 * noise))
    bluish = bytes_of(np.array([0.45, 0.5, 0.75]) + 0.15 * (shade - 0.5) + 0.01 * noise)
    with pytest.raises(InputError, match="rise and fall together"):
        decoded(bluish)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.8), st.floats(-0.3, 0.3), st.floats(0.35, 1.0))
def test_steep_tilted_and_short_normals_are_accepted(seed: int, steep: float, tilt: float, length: float) -> None:
    field = height_field(48, 48, seed, steep) + np.array([0, tilt, 0])
    field *= length / np.linalg.norm(field, axis=-1, keepdims=True)
    vectors, lengths, _ = decode_normals(encoded(field), HERE)
    assert lengths is not None and lengths.mean() == pytest.approx(length, abs=0.01)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1, atol=1e-5)


def test_two_channels_get_their_z_back(tmp_path: Path) -> None:
    field = height_field(32, 32)
    for blue in (0, 255):
        pixels = encoded(field)
        pixels[..., 2] = blue
        vectors, lengths, notes = decode_normals(pixels, HERE)
        np.testing.assert_allclose(vectors, field, atol=0.02)
        assert lengths is None and any("z is reconstructed" in note for note in notes)
    np.testing.assert_allclose(decoded(encoded(field)[..., :2]), field, atol=0.02)


@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("flat", [True, False])
def test_float_normals_are_read_signed_or_encoded(signed: bool, flat: bool, tmp_path: Path) -> None:
    field = np.broadcast_to([0.0, 0, 1], (32, 32, 3)) if flat else height_field(32, 32)
    values = (field if signed else (field + 1) / 2).astype(np.float32)
    path = write_image(tmp_path / "a_normal_gl.exr", values, "half")
    result = load([path], maps={"roughness": 0.5})
    np.testing.assert_allclose(result.maps["normal"].pixels, field, atol=2e-3)
    assert any("signed" in n for n in result.notes) == signed


def test_normals_that_averaging_made_shorter_are_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    fine = height_field(128, 128, steepness=0.2) + 0.3 * rng.normal(size=(128, 128, 3)) * [1, 1, 0]
    fine /= np.linalg.norm(fine, axis=-1, keepdims=True)
    short = fine.reshape(32, 4, 32, 4, 3).mean((1, 3))
    found = load(plain_set(tmp_path, normal_gl=encoded(short)))
    assert any("shorter than one (mean length 0.9" in warning for warning in found.warnings)
    np.testing.assert_allclose(np.linalg.norm(found.maps["normal"].pixels, axis=-1), 1, atol=1e-5)


# ---- holes

BROKEN = {(3, 5): (0.8, 0.1, -0.6), (3, 6): (0, 0, -1.0), (10, 11): (1, 0, 1e-3), (15, 0): (0, 0, 0), (9, 2): (0, 1, 0)}
SLOPE = 0.05


def normals(broken: bool = True, size: int = 16) -> np.ndarray:
    """Normals of a surface that is nearly flat, with texels that no surface has."""
    made = height_field(size, size, steepness=SLOPE)
    for place, vector in BROKEN.items() if broken else ():
        made[place] = vector
    return made


def metal(folder: Path, made: np.ndarray) -> TextureSet:
    folder.mkdir()
    write_image(folder / "metal_normal.png", np.rint((made + 1) / 2 * 65535).astype(np.uint16))
    for name, value in (("base_color", (200, 180, 160)), ("roughness", (80,)), ("metallic", (255,))):
        write_image(folder / f"metal_{name}.png", np.full((16, 16, len(value)), value, np.uint8))
    return load(folder, normal_convention="opengl")


def test_broken_normals_take_the_mean_of_those_around() -> None:
    made = normals()
    length = np.linalg.norm(made, axis=-1).astype(np.float32)
    unit = (made / np.maximum(length, 1e-3)[..., None]).astype(np.float32)
    found, count = held(unit, length)
    assert count == len(BROKEN)
    kept = np.ones(unit.shape[:2], bool)
    kept[tuple(np.array(list(BROKEN)).T)] = False
    np.testing.assert_array_equal(found[kept], unit[kept])
    assert np.linalg.norm(found, axis=-1) == pytest.approx(np.ones((16, 16)), abs=1e-6)
    around = unit[9:12, 10:13].reshape(9, 3)[[0, 1, 2, 3, 5, 6, 7, 8]].mean(0)
    assert found[10, 11] == pytest.approx(around / np.linalg.norm(around), abs=1e-6)


def test_holes_are_filled_from_their_rims_inwards() -> None:
    made = np.full((12, 12, 3), (0, 0.6, 0.8), np.float32)
    made[2:9, 3:11] = (0.6, 0, -0.8)
    found, count = held(made)
    assert count == 56 and found == pytest.approx(np.broadcast_to(made[:1, :1], found.shape), abs=1e-6)
    flat, count = held(np.full((2, 3, 3), (1, 0, 0), np.float32))
    assert count == 6 and (flat == (0, 0, 1)).all()
    whole = normals(False).astype(np.float32)
    assert held(whole)[0] is whole
    for z, holes in ((MIN_NORMAL_Z * 1.001, 0), (MIN_NORMAL_Z * 0.999, 1)):
        assert held(np.array([[[np.sqrt(1 - z * z), 0, z], [0, 0, 1]]], np.float32))[1] == holes


def test_they_are_counted_for_the_user(tmp_path: Path) -> None:
    (warning,) = metal(tmp_path / "metal", normals()).warnings
    assert warning.startswith(f"metal_normal.png: {len(BROKEN)} of 256 normals along the surface, into it or without")
    assert metal(tmp_path / "fine", normals(False)).warnings == ()
    steep = normals(False)
    steep[4, 4] = (1, 0, 1e-3)
    texture_set = TextureSet.from_arrays("metal", normal=steep, roughness=0.3)
    assert "1 of 256 normals" in texture_set.warnings[0]
    assert texture_set.maps["normal"].pixels[..., 2].min() > 0.9


def test_a_level_0_that_is_kept_is_that_of_the_file_elsewhere(tmp_path: Path) -> None:
    made = normals()
    made[:8] *= 0.9  # not unit: to be seen whether it is kept
    texture_set = metal(tmp_path / "metal", made)
    stack = adjusted(mipbake.bake(texture_set, "linear"), texture_set, Adjustments(keep_level0=True))
    kept, wanted = stack.levels[0][..., 5:8], np.rint((made + 1) / 2 * 65535) / 65535 * 2 - 1
    for place in BROKEN:
        wanted[place] = texture_set.maps["normal"].pixels[place]
    assert kept == pytest.approx(wanted, abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("target", ["gltf", "gltf-anisotropic", "ggx"])
@pytest.mark.parametrize("method", METHODS)
def test_no_texel_of_any_level_is_darker_than_those_around(method: str, target: str, tmp_path: Path) -> None:
    """Five broken texels of a glossy surface, of every method: no speck at any level."""

    def levels(texture_set: TextureSet) -> list[np.ndarray]:
        model = texture_set.source_model
        bake = quick_methods(NONE)[method]
        return bake(texture_set.material(model), model, target, "gaussian", texture_set.wrap, lambda _: None).levels

    broken, whole = (metal(tmp_path / str(each), normals(each)) for each in (True, False))
    pairs = pair_set("near-mirror", 1, 64)
    for level, other in zip(levels(broken), levels(whole), strict=True):
        seen, wanted = (
            shading.shade(target, each.reshape(-1, each.shape[-1]), pairs.light, pairs.view).mean((0, 2))
            for each in (level, other)
        )
        # A speck is nearly black. Blends of both sets differ by chance: 0.78 was seen.
        assert (seen > 0.7 * wanted.min()).all() and (seen < 1.25 * wanted.max()).all(), level.shape
