"""Opacity: hidden colours have no part in any level, and what is tested against a cutoff keeps its coverage."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mipbake
from mipbake.baking.methods import method_named
from mipbake.material import MODELS
from mipbake.material.pixel_filter import FILTERS, filtered_levels
from mipbake.source.opacity import keeping_coverage, opacity_of, shown
from mipbake.source.texture_set import TextureSet

from .input_files import height_field
from .stacks import smooth, unit

BOTH = ("wrap", "wrap")
METHODS = ["linear", "toksvig", "vmf", "lean", "godot", "filament", "unreal"]


def masked(opacity: np.ndarray, **others: object) -> TextureSet:
    """What the mask hides is pure red, rough 0 and tilted; the rest has no red at all."""
    shape = opacity.shape[:2]
    seen = opacity[..., None] > 0
    green = np.concatenate([np.zeros((*shape, 1)), smooth(shape, 2, 3)], -1)
    normal = np.where(seen, height_field(*shape), [0.8, 0, 0.6])
    maps = {
        "base_color": np.where(seen, green, [1, 0, 0]),
        "normal": normal,
        "roughness": np.where(seen[..., 0], 0.6, 0.0),
        "opacity": opacity,
    }
    return TextureSet.from_arrays("leaf", **(maps | others))


def random_mask(shape: tuple[int, int], seed: int = 0, share: float = 0.4) -> np.ndarray:
    """0 or 1, in blots."""
    return (smooth(shape, 1, seed)[..., 0] + np.random.default_rng(seed).normal(0, 0.1, shape) > share).astype(float)


@pytest.mark.parametrize(("method", "target"), [*((method, "gltf") for method in METHODS), ("lean", "ggx")])
def test_hidden_colours_are_in_no_level(method, target) -> None:
    """Diffuse albedo and reflectance count by area, since there is no base colour to weigh."""
    texture_set = masked(random_mask((16, 16)))
    assert texture_set.maps["base_color"].pixels[..., 0].max() == 1
    for level in mipbake.bake(texture_set, method, target, "gaussian").levels:
        assert level[..., 0].max() < 1e-5
        assert target == "ggx" or level[..., 4].min() > 0.55  # nor their roughness


@pytest.mark.parametrize(("shape", "wrap"), [((16, 16), BOTH), ((9, 14), ("clamp", "wrap")), ((1, 8), BOTH)])
@pytest.mark.parametrize("pixel_filter", FILTERS)
def test_hidden_colours_are_in_no_level_of_any_filter_and_size(shape, wrap, pixel_filter) -> None:
    opacity = np.zeros(shape)
    opacity.flat[::3] = 1
    stack = mipbake.bake(masked(opacity, wrap=wrap), "linear", "gltf", pixel_filter)
    for level in stack.levels:
        assert level[..., 0].max() < 1e-6


def test_partly_covered_texels_count_by_their_opacity() -> None:
    """Two texels of opacity 0.2 and 0.8: their average is 0.2 and 0.8 of their colours."""
    opacity = np.array([[0.2, 0.8]], np.float32)
    colour = np.array([[[0.9, 0.1, 0.3], [0.1, 0.5, 0.3]]], np.float32)
    texture_set = TextureSet.from_arrays(
        "leaf", normal=[[[0, 0, 1]] * 2], roughness=0.5, base_color=colour, opacity=opacity
    )
    stack = mipbake.bake(texture_set, "linear", pixel_filter="box")
    np.testing.assert_allclose(stack.levels[0][..., :3], colour, atol=1e-6)
    np.testing.assert_allclose(stack.levels[1][0, 0, :3], 0.2 * colour[0, 0] + 0.8 * colour[0, 1], atol=1e-6)


@pytest.mark.parametrize("method", ["linear", "lean"])
@pytest.mark.parametrize("opacity", [None, 1.0, np.ones((4, 4))], ids=["none", "number", "map"])
def test_sets_that_hide_nothing_are_bit_for_bit_as_without_opacity(method, opacity) -> None:
    maps = {"normal": height_field(16, 16), "roughness": smooth((16, 16), 1), "base_color": smooth((16, 16), 3, 4)}
    texture_set = TextureSet.from_arrays("wood", **maps, opacity=opacity)
    found = mipbake.bake(texture_set, method, "gltf")
    stored = texture_set.material("gltf")
    wanted = method_named(method, None, None)(stored, "gltf", "gltf", "gaussian", BOTH, lambda _share: None)
    for level, before in zip(found.levels, wanted.levels, strict=True):
        np.testing.assert_array_equal(level, before)


@pytest.mark.parametrize("target", MODELS)
def test_what_is_wholly_transparent_still_bakes(target) -> None:
    texture_set = masked(np.zeros((8, 8)))
    stack = mipbake.bake(texture_set, "lean", target)
    assert all(np.isfinite(level).all() for level in stack.levels)
    assert (stack.extra["opacity"][0] == 0).all()


def passing(level: np.ndarray, cutoff: float) -> int:
    """Texels that a shader keeps."""
    return int((level >= np.float32(cutoff)).sum())


@settings(max_examples=80, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10**6), st.floats(0.02, 0.98), st.floats(0.05, 0.95))
def test_coverage_is_kept_within_a_texel(height, width, seed, cutoff, density) -> None:
    """This holds for masks whose averages are all different: as many texels pass as the share of level 0 is,
    rounded."""
    rng = np.random.default_rng(seed)
    mask = rng.random((height, width, 1)) ** (np.log(cutoff) / np.log(1 - density))
    levels = filtered_levels(mask.astype(np.float32), "box", BOTH)
    kept = keeping_coverage(levels, cutoff)
    share = passing(kept[0], cutoff) / levels[0].size
    np.testing.assert_array_equal(kept[0], levels[0])
    for level in kept[1:]:
        assert level.min() >= 0 and level.max() <= 1
        assert abs(passing(level, cutoff) - share * level.size) <= 1


@pytest.mark.parametrize("size", [(8, 8), (4, 16), (32, 8), (7, 5)])
def test_opacity_of_another_size(size) -> None:
    """It hides the same part of the surface."""
    half = np.zeros((*size, 1), np.float32)
    half[:, : size[1] // 2] = 1
    given = {"normal": unit(smooth((16, 16), 3)), "roughness": 0.5, "wrap": BOTH}
    found = opacity_of(TextureSet.from_arrays("half", opacity=half, **given))
    assert found is not None and found.shape == (16, 16)
    centre = found[:, 3:5]
    assert (centre == 1).all() and (found[:, 11:13] == 0).all()
    assert opacity_of(TextureSet.from_arrays("all", opacity=np.ones(size), **given)) is None


def test_filling_keeps_what_is_seen_and_normals_are_unit() -> None:
    opacity = random_mask((8, 8), 2).astype(np.float32)
    given = TextureSet.from_arrays(
        "mask", normal=unit(smooth((8, 8), 3) - 0.3), roughness=smooth((8, 8), 1), opacity=opacity, wrap=BOTH
    )
    stored, filled = given.material("gltf"), shown(given).material("gltf")
    np.testing.assert_allclose(filled[opacity > 0], stored[opacity > 0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(filled[..., 5:], axis=-1), 1, atol=1e-6)
    hidden = opacity == 0
    assert hidden.any() and not np.allclose(filled[hidden], stored[hidden], atol=1e-3)
