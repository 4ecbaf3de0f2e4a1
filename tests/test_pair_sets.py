"""Pair sets that find the lobes of a source: means over them are those of the law, and hang on the seed far less."""

from __future__ import annotations

import numpy as np
import pytest

import mipbake
from mipbake import TextureSet
from mipbake.base.errors import UsageError
from mipbake.material import convert
from mipbake.quality.metrics import PAIR_SETS, LightViewPairs, pair_set
from mipbake.quality.reference.pair_sets import weighted_pair_set


def glossy(size: int = 16) -> TextureSet:
    """Polished metal with bumps, some of which are steep."""
    rng = np.random.default_rng(4)
    slopes = rng.standard_normal((size, size, 2)) * np.where(rng.random((size, size, 1)) < 0.1, 0.6, 0.1)
    return TextureSet.from_arrays(
        "glossy",
        base_color=0.2 + 0.7 * rng.random((size, size, 3)),
        normal=np.concatenate([slopes, np.ones((size, size, 1))], -1),
        roughness=0.15 + 0.1 * rng.random((size, size)),
        metallic=np.ones((size, size)),
    )


def texels_of(model: str) -> np.ndarray:
    """(H, W, C) texels, stretched ones where the model knows them."""
    stored = convert(glossy().material("gltf"), "gltf", model)
    if model == "gltf-anisotropic":
        stored[..., 8:] = 0.6, 0.8, 0.5
    return stored


def values(pairs: LightViewPairs) -> np.ndarray:
    """(K, 5) of functions that live on few pairs, and of others."""
    light, view = pairs.light.astype(float), pairs.view.astype(float)
    half = light + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    grazing = (view[:, 2] < 0.2) & (light[:, 2] < 0.3)
    return np.stack([np.ones(len(light)), light[:, 2], half[:, 2] > 0.995, grazing, light[:, 0] > view[:, 1]], -1)


@pytest.mark.parametrize("name", PAIR_SETS)
@pytest.mark.parametrize("model", ["gltf", "gltf-anisotropic", "beckmann"])
def test_weighted_means_are_those_of_the_law(name: str, model: str) -> None:
    expected = values(pair_set(name, 1, 100_000)).mean(0)
    texels = texels_of(model)
    sets = [weighted_pair_set(name, seed, texels, model, 128) for seed in range(20)]
    found = np.stack([(each.weights[:, None] * values(each)).mean(0) for each in sets])
    error = found.std(0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(found.mean(0) - expected) < 4 * error + 0.01 * expected).all()


@pytest.mark.parametrize("name", PAIR_SETS)
def test_sets_are_fixed_by_the_seed(name: str) -> None:
    texels = texels_of("gltf")
    pairs, same, other = (weighted_pair_set(name, seed, texels, "gltf", 128) for seed in (5, 5, 6))
    for directions in (pairs.light, pairs.view):
        assert directions.shape == (128, 3) and directions.dtype == np.float32
        assert np.linalg.norm(directions, axis=-1) == pytest.approx(1, abs=1e-5)
        assert directions[:, 2].min() > 0
    assert pairs.weights.min() > 0 and pairs.weights.max() < 2.5
    assert (pairs.light == same.light).all() and (pairs.weights == same.weights).all()
    assert not np.allclose(pairs.light, other.light)


def test_figures_of_a_glossy_set_hang_on_the_seed_far_less_than_by_the_law() -> None:
    """By the law alone the standard deviation is 0.16 dB for both pair sets."""
    texture_set = glossy()
    stack = mipbake.bake(texture_set, method="lean")
    found = [mipbake.validate(texture_set, stack, (2,), seed, 512, 32, baselines=()) for seed in range(6)]
    for name in PAIR_SETS:
        assert np.std([each.snr("baked", name, 2.0) for each in found], ddof=1) < 0.07


def test_an_unknown_pair_set_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match="near-mirror, hemisphere"):
        weighted_pair_set("everywhere", 0, texels_of("gltf"), "gltf")
