"""Normal maps: the curl test, what is refused as no normal map, holes, and no specks in what is baked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake.base.errors import InputError
from mipbake.source.loading import load
from mipbake.source.normal import DECIDED_CONFIDENCE, decode_normals, integrability, normalised, tiles

from .input_files import bytes_of, encoded, height_field, pixels_for, plain_set, write_image

FLIP = np.array([1, -1, 1], np.float32)
HERE = Path("normal.png")


def decoded(pixels: np.ndarray) -> np.ndarray:
    return decode_normals(pixels, HERE)[0]


@settings(max_examples=30, deadline=None)
@given(
    st.integers(24, 300),
    st.integers(24, 300),
    st.integers(0, 2**32 - 1),
    st.floats(0.05, 1.5),
    st.booleans(),
)
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


@pytest.mark.parametrize("size", [(1, 1), (1, 64), (2, 2), (3, 3), (16, 16), (256, 256)])
def test_noise_and_flatness_are_not_decided(size: tuple[int, int]) -> None:
    flat = np.broadcast_to(np.array([0, 0, 1], np.float32), (*size, 3))
    assert integrability(tiles(flat))[1] == 0
    confidences = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(*size, 3)).astype(np.float32) * 0.2
        confidences.append(integrability(tiles(normalised(noise + np.array([0, 0, 1], np.float32))))[1])
    assert max(confidences) < 1
    if min(size) >= 100:
        assert max(confidences) < 0.3


def test_waves_along_one_axis_are_not_decided() -> None:
    slope = 0.5 * np.sin(np.arange(64) / 3)
    field = np.stack(np.broadcast_arrays(slope[None], np.zeros((64, 64)), 1.0), -1)
    assert integrability(tiles(normalised(field.astype(np.float32))))[1] < 0.75


def test_a_silent_name_is_decided_by_pixels_and_green_ends_up(tmp_path: Path) -> None:
    field = height_field(64, 64)
    for directx in (False, True):
        folder = plain_set(tmp_path / str(directx), normal_gl=pixels_for("normal"))
        (folder / "normal_gl.png").unlink()
        for stem in ("base_color", "roughness"):
            (folder / f"{stem}.png").unlink()
        write_image(folder / "roughness.png", np.full((64, 64), 128, np.uint8))
        write_image(folder / "normal.png", encoded(field, directx))
        result = load(folder)
        assert result.convention.name == ("directx" if directx else "opengl")
        assert result.convention.decided_by == "pixels"
        assert result.convention.confidence > 0.99
        np.testing.assert_allclose(result.maps["normal"].pixels, field, atol=0.01)
        assert any("by the curl of its slopes" in n for n in result.notes)


def test_what_cannot_be_told_is_assumed_with_a_warning(tmp_path: Path) -> None:
    slope = np.broadcast_to(0.5 * np.sin(np.arange(32) / 3), (32, 32))
    waves = np.stack([slope, np.zeros((32, 32)), np.ones((32, 32))], -1)
    folder = plain_set(tmp_path, normal=encoded(waves / np.linalg.norm(waves, axis=-1, keepdims=True)))
    (folder / "normal_gl.png").unlink()
    result = load(folder)
    assert (result.convention.name, result.convention.decided_by) == ("opengl", "assumed")
    assert any("OpenGL is assumed" in w for w in result.warnings)


def test_a_flat_map_has_no_convention_to_tell(tmp_path: Path) -> None:
    flat = np.full((320, 320, 3), (128, 128, 255), np.uint8)
    folder = plain_set(tmp_path, normal=flat)
    (folder / "normal_gl.png").unlink()
    result = load(folder)
    assert (result.convention.name, result.convention.decided_by) == ("opengl", "flat")
    assert result.warnings == ()
    flat[77, 199, :2] = 180  # one dent: now there is something to tell
    write_image(folder / "normal.png", flat)
    assert load(folder).convention.decided_by == "assumed"


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


@pytest.mark.parametrize("value", [(0, 0, 0), (255, 255, 255), (128, 128, 128), (200, 128, 230), (128, 128, 0)])
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
