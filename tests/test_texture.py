"""Texture lookups: the native core against its plain twin, exactness, boundaries, and NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake import _native, sampling
from mipbake.base.errors import UsageError
from mipbake.sampling import reference, texture
from mipbake.sampling._arguments import MAX_SIDE

from .texture_cases import BOUNDARIES, FILTERS, PAIRS, random_case

LINEAR = ("wrap", "clamp", "mirror")


@pytest.mark.long
@pytest.mark.parametrize("filter_mode", FILTERS)
@pytest.mark.parametrize(
    ("dtype", "count", "off"), [(torch.float64, 40, (1e-9, 1e-10)), (torch.float32, 24, (1e-3, 1e-4))]
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
    for case in (random_case(seed, torch.float32, (filter_mode,)) for seed in range(10)):
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
@pytest.mark.parametrize("boundary", PAIRS)
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


def test_a_fractional_lod_blends_linearly() -> None:
    rng = np.random.default_rng(5)
    levels = [rng.random((h, w, 4)) for h, w in ((8, 8), (4, 4), (2, 2))]
    uv = rng.random((50, 2))
    fine, coarse = stacked(levels, uv, 1.0), stacked(levels, uv, 2.0)
    np.testing.assert_allclose(stacked(levels, uv, 1.25), 0.75 * fine + 0.25 * coarse, rtol=1e-14)


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


def test_linear_ramps_are_reproduced_between_the_outer_centres() -> None:
    height, width = 6, 11
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    ramp = np.stack([u, v, 2 * u - 3 * v + 1], -1)
    rng = np.random.default_rng(6)
    margin = 0.5 / np.array([width, height])
    uv = margin + rng.random((200, 2)) * (1 - 2 * margin)
    expected = np.stack([uv[:, 0], uv[:, 1], 2 * uv[:, 0] - 3 * uv[:, 1] + 1], -1)
    for boundary in PAIRS:
        np.testing.assert_allclose(lookup(ramp, uv, None, boundary), expected, rtol=0, atol=1e-13)


def test_clamped_axes_keep_their_edge() -> None:
    texels = np.random.default_rng(7).random((4, 6, 2))
    uv = np.array([[-3.0, 0.3], [0.01, 0.3], [0.999, 0.3], [50.0, 0.3], [-np.inf, 0.3], [np.inf, 0.3]])
    inside = np.array([[0.5 / 6, 0.3]] * 2 + [[5.5 / 6, 0.3]] * 2 + [[0.5 / 6, 0.3], [5.5 / 6, 0.3]])
    expected = lookup(texels, inside)
    np.testing.assert_allclose(lookup(texels, uv, None, ("clamp", "wrap")), expected, rtol=1e-14)
    flipped = np.ascontiguousarray(texels.transpose(1, 0, 2))
    np.testing.assert_allclose(lookup(flipped, uv[:, ::-1], None, ("wrap", "clamp")), expected, rtol=1e-14)


@pytest.mark.parametrize("filter_mode", ["nearest", "linear"])
def test_mirrored_axes_run_back_and_forth(filter_mode: str) -> None:
    texels = np.random.default_rng(8).random((5, 7, 3))
    uv = np.random.default_rng(9).integers(0, 8192, (100, 2)) / 8192 + 1 / 16384
    expected = lookup(texels, uv, None, "clamp", filter_mode=filter_mode)
    for shift, sign in ((0, -1), (2, 1), (2, -1), (-2, 1), (-4, -1), (1000, 1)):
        for axis in (0, 1):
            there = uv.copy()
            there[:, axis] = shift + sign * uv[:, axis]
            out = lookup(texels, there, None, "mirror", filter_mode=filter_mode)
            np.testing.assert_allclose(out, expected, rtol=0, atol=1e-13)


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


def test_wrapped_lookups_are_continuous_and_periodic() -> None:
    rng = np.random.default_rng(8)
    texels = rng.random((5, 7, 3))
    border = np.stack([np.zeros(9), rng.random(9)], -1)
    step = np.array([1e-9, 0])
    for axis in (slice(None), slice(None, None, -1)):
        before, after = lookup(texels, (border - step)[:, axis]), lookup(texels, (border + step)[:, axis])
        np.testing.assert_allclose(before, after, rtol=0, atol=1e-7)
        np.testing.assert_allclose(lookup(texels, border[:, axis]), (before + after) / 2, rtol=0, atol=1e-7)
    # Halves and quarters stay exact in float64 when whole numbers are added.
    uv = rng.integers(0, 64, (40, 2)) / 64
    for filter_mode in ("nearest", "linear"):
        for shift in ([1, 0], [-1, 2], [-1000, 4096], [10**6, -(10**9)]):
            out = lookup(texels, uv + shift, filter_mode=filter_mode)
            np.testing.assert_array_equal(out, lookup(texels, uv, filter_mode=filter_mode))


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


def test_half_storage_is_that_of_torch() -> None:
    rng = np.random.default_rng(11)
    tex = rng.random((2, 13, 9, 5)).astype(np.float16)
    uv, uv_da = rng.normal(0, 1, (1, 4, 9, 2)), rng.normal(0, 0.1, (1, 4, 9, 4))
    out = texture(tex, uv, uv_da)
    assert out.dtype == np.float32
    expected = texture(*(torch.from_numpy(a) for a in (tex, uv, uv_da)))
    np.testing.assert_array_equal(out, expected.numpy())
    for level, other in zip(
        sampling.texture_construct_mip(tex).levels,
        sampling.texture_construct_mip(torch.from_numpy(tex)).levels,
        strict=True,
    ):
        assert level.dtype == np.float16
        np.testing.assert_array_equal(level, other.numpy())


def test_no_lookups_give_an_empty_result() -> None:
    assert texture(np.ones((1, 2, 2, 5)), np.empty((1, 0, 7, 2))).shape == (1, 0, 7, 5)
    assert texture(np.ones((3, 2, 2, 5)), np.empty((1, 4, 0, 2)), None, np.empty((1, 1, 1))).shape == (3, 4, 0, 5)


def test_plain_numbers_and_lists_are_coordinates() -> None:
    level = np.arange(4.0).reshape(1, 1, 4, 1)
    np.testing.assert_array_equal(texture(level, [[[[0.125, 0.5], [0.375, 0.5]]]]), [[[[0], [1]]]])
    np.testing.assert_array_equal(texture(level, [[[[0, 0]]]], mip_level_bias=[[[0]]]), [[[[1.5]]]])


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_values_do_not_depend_on_the_number_of_threads(threads: int) -> None:
    rng = np.random.default_rng(10)
    tex = rng.random((2, 301, 200, 4), np.float32)
    uv, bias = rng.normal(0, 1, (2, 1, 9001, 2)), rng.uniform(0, 9, (1, 1, 9001))
    da = rng.normal(0, 0.02, (1, 1, 9001, 4))
    default = _native.num_threads()
    try:
        _native.set_num_threads(1)
        alone = [texture(tex, uv, da, bias), texture(tex, uv, da, filter_mode="anisotropic")]
        _native.set_num_threads(threads)
        again = [texture(tex, uv, da, bias), texture(tex, uv, da, filter_mode="anisotropic")]
        np.testing.assert_array_equal(again, alone)
    finally:
        _native.set_num_threads(default)
