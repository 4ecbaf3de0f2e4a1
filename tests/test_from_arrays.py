"""Texture sets made from arrays: what is taken, and what is told from what a file would hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import InputError, UsageError
from mipbake.source.texture_set import TextureSet

from .input_files import height_field, pixels_for


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
    plain = TextureSet.from_arrays("brass", **arrays())
    assert not plain.anisotropic
    grey = TextureSet.from_arrays("grey", **arrays(base_color=np.full((8, 12), 0.25)))
    assert (grey.maps["base_color"].pixels == np.full((8, 12, 3), 0.25)).all()
    assert plain.source_hash != result.source_hash
    assert plain.source_hash == TextureSet.from_arrays("brass", **arrays()).source_hash


def test_the_arrays_given_are_copied() -> None:
    roughness = np.full((8, 12, 1), 0.5, np.float32)
    result = TextureSet.from_arrays("a", **arrays(roughness=roughness))
    roughness[:] = 0
    assert (result.maps["roughness"].pixels == 0.5).all()


@pytest.mark.parametrize(
    ("others", "match"),
    [
        ({"roughness": np.full((8, 12), 1.5)}, r"roughness runs from 1\.5 to 1\.5"),
        ({"roughness": np.full((8, 12), np.nan)}, "roughness holds 96 NaN"),
        ({"roughness": np.ones((8, 12, 3))}, r"roughness has shape \(8, 12, 3\)"),
        ({"roughness": np.ones((8, 8))}, "roughness is 8 x 8 and the largest map is 12 x 8"),
        ({"roughness": np.ones((0, 8))}, "at least 1 x 1"),
        ({"base_color": np.ones((8, 12, 4))}, r"base_color has shape \(8, 12, 4\)"),
        ({"normal": height_field(8, 12) * [1, 1, -1]}, "points into the surface"),
        ({"normal": 0.5}, r"normal has shape \(\)"),
        ({"emissive": np.full((8, 12, 3), -1.0)}, "emissive runs from -1"),
        ({"metallic": -0.1}, "metallic runs from"),
    ],
)
def test_arrays_that_are_no_texture_set_are_refused(others: dict[str, Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        TextureSet.from_arrays("a", **arrays(**others))
    with pytest.raises(UsageError, match="wrap"):
        TextureSet.from_arrays("a", wrap=("wrap", "mirror"), **arrays())


def signed() -> np.ndarray:
    return height_field(16, 16).astype(np.float32)


@pytest.mark.parametrize(("top", "told"), [(1, "0 to 1"), (255, "0 to 255"), (65535, "0 to 65535")])
def test_encoded_normals_are_told_from_signed_ones(top: int, told: str) -> None:
    values = (signed() + 1) / 2 * top
    with pytest.raises(InputError, match=f"normal is encoded in {told}.*expected signed vectors, pass 2"):
        TextureSet.from_arrays("a", normal=values if top == 1 else np.rint(values).astype(np.uint16), roughness=0.5)


@pytest.mark.parametrize("normal", [np.float32([[[0, 0, 1]]]), np.float32([[[0.6, 0, 0.8]]]), signed() * 3])
def test_signed_normals_of_any_length_pass(normal: np.ndarray) -> None:
    made = TextureSet.from_arrays("a", normal=normal, roughness=0.5)
    np.testing.assert_allclose(np.linalg.norm(made.maps["normal"].pixels, axis=-1), 1, atol=1e-5)


def test_encoded_directions_are_told() -> None:
    angle = np.linspace(0, 6, 64).reshape(8, 8)
    both = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], -1)
    TextureSet.from_arrays("a", normal=signed(), roughness=0.5, anisotropy=both)
    with pytest.raises(InputError, match=r"anisotropy is encoded in 0 to 1.*2 \* values - 1 for x and y"):
        TextureSet.from_arrays("a", normal=signed(), roughness=0.5, anisotropy=(both + 1) / [2, 2, 1] - [0, 0, 1])


@pytest.mark.parametrize(
    ("role", "told"),
    [("roughness", "values / 255$"), ("base_color", "decoded from sRGB$"), ("emissive", "decoded from sRGB$")],
)
def test_integers_of_files_are_told(role: str, told: str) -> None:
    given = {"roughness": 0.5} | {role: pixels_for(role if role != "roughness" else "height", 16)}
    with pytest.raises(InputError, match=f"{role} holds integers up to .*{told}"):
        TextureSet.from_arrays("a", normal=signed(), **given)
    mask = np.eye(16, dtype=np.uint8)
    assert TextureSet.from_arrays("a", normal=signed(), roughness=0.5, metallic=mask).maps["metallic"].pixels.max() == 1
