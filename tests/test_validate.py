"""The reference that everything is measured against is itself measured here."""

from __future__ import annotations

import numpy as np
import pytest

import mipbake
from mipbake import TextureSet
from mipbake.base.errors import UsageError
from mipbake.comparing.validate import BAKED
from mipbake.quality.reference.pair_sets import weighted_pair_set


def flat(height: int, width: int, base: np.ndarray | float = 0.5, roughness: float = 0.4) -> TextureSet:
    return TextureSet.from_arrays(
        "flat",
        base_color=np.broadcast_to(np.asarray(base, np.float32), (height, width, 3)),
        normal=np.broadcast_to(np.array([0, 0, 1], np.float32), (height, width, 3)),
        roughness=np.full((height, width), roughness, np.float32),
    )


def bumpy(size: int = 64) -> TextureSet:
    rng = np.random.default_rng(2)
    normal = np.concatenate([0.25 * rng.standard_normal((size, size, 2)), np.ones((size, size, 1))], -1)
    return TextureSet.from_arrays(
        "bumpy", base_color=rng.random((size, size, 3)), normal=normal, roughness=np.full((size, size), 0.35)
    )


@pytest.mark.parametrize("pixel_filter", ["gaussian", "mitchell"])
def test_a_constant_material_has_no_error(pixel_filter: str) -> None:
    texture_set = flat(16, 16)
    stack = mipbake.bake(texture_set, method="linear", pixel_filter=pixel_filter)
    result = mipbake.validate(texture_set, stack, points=64, samples=64)
    assert min(row.snr for row in result.rows) > 60


def test_a_checker_of_two_texels_matches_the_computation_on_paper() -> None:
    """Base colour 0 and 1 in a 2 x 1 texture, flat and dielectric: f = base d + s is linear in base colour.

    At lod 0, bilinear lookups make base a triangle wave t(x) = |x|, x in texels. Under the box filter of one texel it
    becomes x^2 + 1/4 for |x| < 1/2 and is symmetric about 1/2, so (t - box * t)^2 = (1/2 - |x|)^4 has the mean 1/80
    and box * t has the mean 1/2 and the mean square 17/60. At lod 1 a box covers the texture: the average is exact.
    """
    texture_set = flat(1, 2, np.array([[[0.0], [1.0]]]))
    stack = mipbake.bake(texture_set, method="linear", pixel_filter="box")
    result = mipbake.validate(texture_set, stack, lods=(0, 1), points=4096, samples=128)
    for name in ("near-mirror", "hemisphere"):
        pairs = weighted_pair_set(name, result.seed, texture_set.material("gltf"), "gltf")
        light, view = pairs.light.astype(float), pairs.view.astype(float)
        half = (light + view) / np.linalg.norm(light + view, axis=-1, keepdims=True)
        fresnel = 0.04 + 0.96 * (1 - (light * half).sum(-1)) ** 5
        alpha2, (l_n, v_n, h_n) = 0.4**4, (w[:, 2] for w in (light, view, half))
        distribution = alpha2 / (np.pi * (h_n**2 * (alpha2 - 1) + 1) ** 2)
        smith = l_n * np.sqrt(v_n**2 * (1 - alpha2) + alpha2) + v_n * np.sqrt(l_n**2 * (1 - alpha2) + alpha2)
        diffuse = (1 - fresnel) / np.pi * l_n
        specular = distribution * fresnel / (2 * smith) * l_n
        signal = pairs.weights @ (diffuse**2 * 17 / 60 + diffuse * specular + specular**2)
        expected = 10 * np.log10(signal / (pairs.weights @ (diffuse**2 / 80)))
        assert result.snr(BAKED, name, 0.0) == pytest.approx(expected, abs=0.05)
        assert result.snr(BAKED, name, 1.0) > 55


def test_levels_beyond_the_last_are_measured_there_and_said_and_so_are_foreign_stacks() -> None:
    texture_set = bumpy(16)
    stack = mipbake.bake(texture_set, method="linear")
    result = mipbake.validate(texture_set, stack, lods=(0, 7), points=32, samples=16)
    assert result.lods == (0.0, 4.0)
    assert any("lod 4" in note for note in result.notes)
    stack = mipbake.bake(flat(16, 16), method="linear")
    result = mipbake.validate(texture_set, stack, points=32, samples=16)
    assert any("hashes differ" in note for note in result.notes)
    with pytest.raises(UsageError, match="lods"):
        mipbake.validate(texture_set, stack, lods=(-1,))
