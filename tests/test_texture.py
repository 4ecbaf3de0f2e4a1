"""Texture lookups: the native core against its plain twin, exactness, boundaries, and NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake import sampling
from mipbake.base.errors import UsageError
from mipbake.sampling import reference, texture
from mipbake.sampling._arguments import MAX_SIDE
from mipbake.sampling.taps import linear_taps

from .texture_cases import BOUNDARIES, FILTERS, random_case

LINEAR = ("wrap", "clamp", "mirror")


@pytest.mark.parametrize("filter_mode", FILTERS)
@pytest.mark.parametrize(
    ("dtype", "count", "off"), [(torch.float64, 16, (1e-9, 1e-10)), (torch.float32, 10, (1e-3, 1e-4))]
)
def test_native_and_twin_agree(filter_mode: str, dtype: torch.dtype, count: int, off: tuple[float, float]) -> None:
    for seed in range(count):
        case = random_case(seed, dtype, (filter_mode,))
        expected, actual = case.values_and_gradients(reference), case.values_and_gradients(sampling)
        assert actual.keys() >= expected.keys() - {"uv"}
        # Coordinates are exact. In single precision the level of detail is to some 1e-6, and texels span 1.
        assert float((actual["out"] - expected["out"]).abs().max()) < 1e-5, seed
        for name, e in expected.items():
            a = actual.get(name, torch.zeros_like(e))
            assert torch.allclose(a, e, rtol=off[0], atol=off[1] * max(1.0, float(e.abs().max()))), (seed, name)


def array(tensor: Any) -> Any:
    return None if tensor is None else tensor.detach().numpy()


@pytest.mark.parametrize("filter_mode", FILTERS)
def test_numpy_and_torch_agree_exactly(filter_mode: str) -> None:
    for case in (random_case(seed, torch.float32, (filter_mode,)) for seed in range(4)):
        custom = None if case.custom is None else [array(level) for level in case.custom]
        arrays: Any = [array(t) for t in (case.tex, case.uv, case.uv_da, case.bias)]
        if case.constructed:
            custom = sampling.texture_construct_mip(arrays[0], cube_mode=case.boundary_mode == "cube")
        out = texture(*arrays, custom, case.filter_mode, case.boundary_mode, case.max_mip_level)
        assert out.dtype == np.float32
        np.testing.assert_array_equal(out, case.call(sampling).detach().numpy())


def lookup(tex: Any, uv: Any, lod: Any = None, boundary: Any = "wrap", **options: Any) -> Any:
    """(P, C) of one (H, W, C) texture at (P, 2), with a level of detail as the bias."""
    uv = np.asarray(uv)
    bias = None if lod is None else np.asarray(lod, float).reshape(1, 1, -1)
    return texture(tex[None], uv[None, None], None, bias, boundary_mode=boundary, **options)[0, 0]


def stacked(levels: list[Any], uv: Any, lod: Any, boundary: Any = "wrap") -> Any:
    return lookup(levels[0], uv, lod, boundary, mip=[level[None] for level in levels[1:]])


def texel_centres(height: int, width: int, dtype: Any = np.float64) -> Any:
    u, v = (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height
    return np.stack(np.meshgrid(u, v), -1).reshape(-1, 2).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("boundary", [*((b, b) for b in BOUNDARIES), ("wrap", "clamp"), ("zero", "mirror")])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (49, 3), (37, 64), (83, 107), (1, 4095)])
def test_texel_centres_return_the_texels(size: tuple[int, int], boundary: tuple[str, str], dtype: Any) -> None:
    rng = np.random.default_rng(3)
    texels = rng.standard_normal((*size, 3)).astype(dtype)
    uv = texel_centres(*size, dtype)
    for filter_mode in ("linear", "nearest"):
        np.testing.assert_array_equal(
            lookup(texels, uv, None, boundary, filter_mode=filter_mode), texels.reshape(-1, 3)
        )
    if boundary == ("wrap", "wrap"):
        for shift in (-1, 1):
            np.testing.assert_array_equal(lookup(texels, uv + np.array(shift, dtype)), texels.reshape(-1, 3))


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_whole_lods_pick_their_level(boundary: str) -> None:
    rng = np.random.default_rng(4)
    levels = [rng.random((h, w, 8), np.float32) for h, w in ((12, 20), (6, 10), (3, 5), (1, 2))]
    for index, level in enumerate(levels):
        uv = texel_centres(*level.shape[:2])
        np.testing.assert_array_equal(stacked(levels, uv, [index] * len(uv), boundary), level.reshape(-1, 8))
    uv = rng.random((30, 2))
    for lod, expected in ((0, 0), (1, 1), (2, 2), (3, 3), (-7.5, 0), (99, 3), (np.inf, 3), (-np.inf, 0)):
        np.testing.assert_array_equal(stacked(levels, uv, lod, boundary), lookup(levels[expected], uv, None, boundary))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@settings(max_examples=30, deadline=None)
@given(
    value=st.floats(-1e6, 1e6, width=32),
    seed=st.integers(0, 2**32 - 1),
    boundary=st.tuples(st.sampled_from(LINEAR), st.sampled_from(LINEAR)),
    filter_mode=st.sampled_from(["linear", "linear-mipmap-nearest", "linear-mipmap-linear"]),
)
def test_constants_stay_constant(dtype: Any, value: float, seed: int, boundary: Any, filter_mode: str) -> None:
    rng = np.random.default_rng(seed)
    size = rng.integers(1, 30, 2)
    tex = np.full((*size, 11), value, dtype)
    out = lookup(tex, rng.normal(0, 10, (64, 2)), rng.uniform(-1, 6, 64), boundary, filter_mode=filter_mode)
    np.testing.assert_array_equal(out, np.full((64, 11), value, dtype))


def test_beyond_the_border_is_zero() -> None:
    texels = np.random.default_rng(10).random((4, 6, 2)) + 1
    for u, weight in ((0.0, 0.5), (-0.25 / 6, 0.25), (1 + 0.4 / 6, 0.1), (-0.5 / 6, 0), (1 + 0.6 / 6, 0), (-3, 0)):
        for there, boundary in (([u, 0.3], ("zero", "wrap")), ([u, 0.3], ("zero", "zero"))):
            edge = lookup(texels, [[np.clip(u, 0.5 / 6, 5.5 / 6), 0.3]])
            out = lookup(texels, [there], None, boundary)
            np.testing.assert_allclose(out, weight * edge, rtol=1e-13, atol=1e-14)
    outside = [[-0.01, 0.5], [1.0, 0.5], [0.5, -1e-9], [0.5, 7.0], [np.inf, 0.5], [-np.inf, 0.5]]
    assert np.all(lookup(texels, outside, None, "zero", filter_mode="nearest") == 0)
    np.testing.assert_array_equal(lookup(texels, [[0.0, 0.999]], None, "zero", filter_mode="nearest"), texels[3:4, 0])
    assert np.all(lookup(texels, [[np.inf, 0.5], [-np.inf, 0.5], [0.5, np.inf]], None, "zero") == 0)
    # What is outside does not leak in, not even as 0 times infinity.
    texels[:, 0] = np.inf
    assert np.all(np.isfinite(lookup(texels, [[1.0, 0.5], [5.5 / 6, 0.5]], None, "zero")))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("filter_mode", ["nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear"])
@pytest.mark.parametrize("boundary", [*((b, b) for b in LINEAR), ("wrap", "clamp"), ("zero", "zero")])
def test_extreme_and_undefined_coordinates(boundary: tuple[str, str], filter_mode: str, dtype: Any) -> None:
    tex = np.ones((5, 4, 3), dtype)
    big = np.finfo(dtype).max
    finite = np.array([0.0, -0.0, big, -big, np.finfo(dtype).tiny, 2.0**31, -(2.0**63), 1 - 2.0**-24], dtype)
    uv = np.stack(np.meshgrid(finite, finite), -1).reshape(-1, 2)
    out = lookup(tex, uv, 0.5, boundary, filter_mode=filter_mode)
    if "zero" in boundary:
        assert np.all((out >= 0) & (out <= 1)) and np.all(out[np.abs(uv).max(-1) > 2] == 0)
    else:
        np.testing.assert_array_equal(out, 1)
    for bad in (np.nan, np.inf, -np.inf):
        for axis in (0, 1):
            uv = np.full((1, 2), 0.4, dtype)
            uv[0, axis] = bad
            undefined = np.isnan(bad) or boundary[axis] in ("wrap", "mirror")
            assert np.all(np.isnan(lookup(tex, uv, 0.5, boundary, filter_mode=filter_mode)) == undefined)
    middle = np.full((1, 2), 0.4, dtype)
    has_levels = "mipmap" in filter_mode
    assert np.all(np.isnan(lookup(tex, middle, np.nan, boundary, filter_mode=filter_mode)) == has_levels)
    assert np.all(lookup(tex, middle, -np.inf, boundary, filter_mode=filter_mode) == 1)


def test_other_levels_never_leak_in() -> None:
    levels = [np.full((4, 4, 2), np.nan), np.ones((2, 2, 2)), np.full((1, 1, 2), np.inf)]
    assert np.all(stacked(levels, np.random.default_rng(0).random((20, 2)), 1.0) == 1)


def test_views_are_read_in_place() -> None:
    rng = np.random.default_rng(9)
    atlas = rng.random((3, 40, 50, 9), np.float32)
    uv = rng.random((1, 5, 12, 2))
    da = np.array([0.05, 0.01, 0.0, 0.09])[None, None, None].repeat(5, 1).repeat(12, 2)
    views = (atlas[:, 5:20, 10:33], atlas[:, ::-1, ::2], atlas[..., 2:6], atlas[::-1], atlas.swapaxes(1, 2))
    for view in (*views, atlas[..., ::-1], np.asfortranarray(atlas)):
        whole = np.ascontiguousarray(view)
        np.testing.assert_array_equal(texture(view, uv), texture(whole, uv))
        np.testing.assert_array_equal(texture(view, uv, da), texture(whole, uv, da))
    frozen = atlas.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(texture(frozen, uv, da), texture(atlas, uv, da))
    packed = np.frombuffer(b"\0" + atlas.tobytes(), np.float32, offset=1).reshape(atlas.shape)
    np.testing.assert_array_equal(texture(packed, uv, da), texture(atlas, uv, da))
    flipped = uv[:, ::-1, :, ::-1]
    np.testing.assert_array_equal(texture(atlas, flipped), texture(atlas, np.ascontiguousarray(flipped)))


@pytest.mark.parametrize("filter_mode", ["nearest", "linear"])
def test_long_textures_are_not_read_outside(filter_mode: str) -> None:
    """The longest that are allowed, at coordinates that round to the end of the texture."""
    size = MAX_SIDE
    wide = np.zeros((1, 1, size + 2, 1), np.float32)
    wide[:, :, size:] = 777
    u = np.array([-1e-9, 1 - 2.0**-24, -1 - 2.0**-23, 2 - 2.0**-23, 1, 5, 0], np.float32)
    uv = np.stack([u, np.full_like(u, 0.5)], -1)[None, None]
    for boundary in BOUNDARIES:
        out = texture(wide[:, :, :size], uv, filter_mode=filter_mode, boundary_mode=(boundary, "wrap"))
        np.testing.assert_array_equal(out, np.zeros_like(out))
    with pytest.raises(UsageError, match=rf"tex has shape .*: expected at most {size} texels a side"):
        texture(wide, uv)


def test_plain_numbers_and_lists_are_coordinates() -> None:
    level = np.arange(4.0).reshape(1, 1, 4, 1)
    np.testing.assert_array_equal(texture(level, [[[[0.125, 0.5], [0.375, 0.5]]]]), [[[[0], [1]]]])
    np.testing.assert_array_equal(texture(level, [[[[0, 0]]]], mip_level_bias=[[[0]]]), [[[[1.5]]]])


@pytest.mark.parametrize("boundary", [("wrap", "wrap"), ("clamp", "wrap"), ("clamp", "clamp")])
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (64, 64), (37, 1000), (4096, 5)])
def test_lookups_of_known_texels_have_the_bits_of_the_kernel(size: tuple[int, int], boundary: tuple[str, str]) -> None:
    rng = np.random.default_rng(0)
    image = rng.standard_normal((*size, 8)).astype(np.float32)
    spread = rng.random((2000, 2)) * 3 - 1
    centres = (rng.integers(-2, 2 * max(size), (500, 2)) + 0.5) / size[::-1]
    corners = rng.integers(-2, 2 * max(size), (500, 2)) / size[::-1]
    uv = np.concatenate([spread, centres, corners, np.array([[0.0, 1.0], [-1e-9, 1 + 1e-9], [1e6, -1e6]])])
    taps = linear_taps(size, uv, boundary)
    found = taps.mixed(image.reshape(-1, 8))
    expected = sampling.texture(image[None], uv[None, None], filter_mode="linear", boundary_mode=boundary)[0, 0]
    np.testing.assert_array_equal(found, expected)
