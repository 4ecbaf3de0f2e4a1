"""Texture lookups: exactness, wrap modes, and the native core against its plain twin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake import _native
from mipbake.errors import UsageError
from mipbake.sampling import ops, reference, sample

WRAPS = [("wrap", "wrap"), ("clamp", "clamp"), ("wrap", "clamp"), ("clamp", "wrap")]
SIDES = st.sampled_from([1, 2, 3, 5, 8, 13])


@dataclass
class Case:
    """Arguments of a lookup as torch leaves, and the gradient that flows back."""

    levels: list[torch.Tensor]
    uv: torch.Tensor
    lod: torch.Tensor
    wrap: tuple[str, str]
    grad: torch.Tensor

    def leaves(self) -> list[torch.Tensor]:
        return [*self.levels, self.uv, self.lod]

    def copy(self) -> Case:
        levels = [level.detach().clone().requires_grad_() for level in self.levels]
        uv, lod = self.uv.detach().clone().requires_grad_(), self.lod.detach().clone().requires_grad_()
        return Case(levels, uv, lod, self.wrap, self.grad)


@st.composite
def cases(draw: st.DrawFn, dtype: torch.dtype) -> Case:
    batches = draw(st.sampled_from([(), (1,), (3,)]))
    channels = draw(st.sampled_from([1, 2, 3, 4, 5, 8, 11, 17]))
    sizes = draw(st.lists(st.tuples(SIDES, SIDES), min_size=1, max_size=5))
    points = draw(st.sampled_from([1, 7, 40, 75]))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**32)))
    options = {"generator": generator, "dtype": dtype}
    levels = [torch.rand(*batches, h, w, channels, **options) for h, w in sizes]
    uv_batch = draw(st.sampled_from([(), (1,), (3,)]))
    uv = torch.randn(*uv_batch, points, 2, **options) * draw(st.sampled_from([0.3, 1.0, 30.0]))
    lod_shape = draw(st.sampled_from([(), (points,), (*uv_batch, points), (3, points)]))
    lod = torch.rand(lod_shape, **options) * (len(sizes) + 2) - 1
    if draw(st.booleans()):
        lod = lod.round()
    batch = [b for b in (batches, uv_batch, lod_shape[:-1]) if b]
    result = (*([max(b[0] for b in batch)] if batch else []), points, channels)
    grad = torch.randn(result, **options)
    return Case(levels, uv, lod, draw(st.sampled_from(WRAPS)), grad).copy()


def values_and_gradients(door: Any, case: Case) -> list[torch.Tensor]:
    case = case.copy()
    out = door(case.levels, case.uv, case.lod, case.wrap)
    assert out.shape == case.grad.shape
    out.backward(case.grad)
    return [out.detach(), *(leaf.grad for leaf in case.leaves() if leaf.grad is not None)]


@settings(max_examples=150, deadline=None)
@given(cases(torch.float64))
def test_native_and_twin_agree_in_double(case: Case) -> None:
    expected = values_and_gradients(reference.sample, case)
    actual = values_and_gradients(ops.sample, case)
    assert len(actual) == len(expected) == len(case.leaves()) + 1
    for a, e in zip(actual, expected, strict=True):
        assert torch.allclose(a, e, rtol=1e-10, atol=1e-11 * max(1.0, float(e.abs().max())))


@settings(max_examples=100, deadline=None)
@given(cases(torch.float32))
def test_native_and_twin_agree_in_single(case: Case) -> None:
    expected = values_and_gradients(reference.sample, case)
    actual = values_and_gradients(ops.sample, case)
    # Texels span 1. The largest uv are near 100, where float32 resolves 1e-5 of the texture: what remains after the
    # wrap is the same in both, so that values differ by rounding of the interpolation alone.
    assert float((actual[0] - expected[0]).abs().max()) < 1e-6
    for a, e in zip(actual[1:], expected[1:], strict=True):
        assert torch.allclose(a, e, rtol=1e-4, atol=1e-5 * max(1.0, float(e.abs().max())))


@settings(max_examples=50, deadline=None)
@given(cases(torch.float32))
def test_numpy_and_torch_doors_agree_exactly(case: Case) -> None:
    arrays = [level.detach().numpy() for level in case.levels]
    out = sample(arrays, case.uv.detach().numpy(), case.lod.detach().numpy(), case.wrap)
    expected = ops.sample(case.levels, case.uv, case.lod, case.wrap).detach().numpy()
    assert out.dtype == np.float32
    np.testing.assert_array_equal(out, expected)


def texel_centres(height: int, width: int, dtype: Any = np.float64) -> Any:
    u, v = (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height
    return np.stack(np.meshgrid(u, v), -1).reshape(-1, 2).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (49, 3), (37, 64), (83, 107), (1, 4095)])
def test_texel_centres_return_the_texels(size: tuple[int, int], wrap: tuple[str, str], dtype: Any) -> None:
    rng = np.random.default_rng(3)
    texels = rng.standard_normal((*size, 3)).astype(dtype)
    uv = texel_centres(*size, dtype)
    np.testing.assert_array_equal(sample([texels], uv, 0.0, wrap), texels.reshape(-1, 3))
    if wrap == ("wrap", "wrap"):
        for shift in (-1, 1):
            out = sample([texels], uv + np.array(shift, dtype), 0.0, wrap)
            np.testing.assert_array_equal(out, texels.reshape(-1, 3))


@pytest.mark.parametrize("wrap", WRAPS)
def test_whole_lods_pick_their_level(wrap: tuple[str, str]) -> None:
    rng = np.random.default_rng(4)
    levels = [rng.random((h, w, 8), np.float32) for h, w in ((12, 20), (6, 10), (3, 5), (1, 2))]
    for index, level in enumerate(levels):
        uv = texel_centres(*level.shape[:2])
        np.testing.assert_array_equal(sample(levels, uv, index, wrap), level.reshape(-1, 8))
    uv = rng.random((30, 2))
    for index, level in enumerate(levels):
        np.testing.assert_array_equal(sample(levels, uv, index, wrap), sample([level], uv, 0.0, wrap))
    np.testing.assert_array_equal(sample(levels, uv, -7.5, wrap), sample(levels, uv, 0, wrap))
    np.testing.assert_array_equal(sample(levels, uv, 99.0, wrap), sample(levels, uv, 3, wrap))
    np.testing.assert_array_equal(sample(levels, uv, np.inf, wrap), sample(levels, uv, 3, wrap))


def test_a_fractional_lod_blends_linearly() -> None:
    rng = np.random.default_rng(5)
    levels = [rng.random((h, w, 4)) for h, w in ((8, 8), (4, 4), (2, 2))]
    uv = rng.random((50, 2))
    fine, coarse = sample(levels, uv, 1.0), sample(levels, uv, 2.0)
    np.testing.assert_allclose(sample(levels, uv, 1.25), 0.75 * fine + 0.25 * coarse, rtol=1e-14)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@settings(max_examples=30, deadline=None)
@given(value=st.floats(-1e6, 1e6, width=32), seed=st.integers(0, 2**32 - 1), wrap=st.sampled_from(WRAPS))
def test_constants_stay_constant(dtype: Any, value: float, seed: int, wrap: tuple[str, str]) -> None:
    rng = np.random.default_rng(seed)
    levels = [np.full((h, w, 11), value, dtype) for h, w in ((9, 4), (5, 2), (1, 1))]
    uv = rng.normal(0, 10, (64, 2))
    out = sample(levels, uv, rng.uniform(-1, 4, 64), wrap)
    np.testing.assert_array_equal(out, np.full((64, 11), value, dtype))


def test_linear_ramps_are_reproduced_between_the_outer_centres() -> None:
    height, width = 6, 11
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    ramp = np.stack([u, v, 2 * u - 3 * v + 1], -1)
    rng = np.random.default_rng(6)
    margin = 0.5 / np.array([width, height])
    uv = margin + rng.random((200, 2)) * (1 - 2 * margin)
    expected = np.stack([uv[:, 0], uv[:, 1], 2 * uv[:, 0] - 3 * uv[:, 1] + 1], -1)
    for wrap in WRAPS:
        np.testing.assert_allclose(sample([ramp], uv, 0.0, wrap), expected, rtol=0, atol=1e-13)


def test_clamped_axes_keep_their_edge() -> None:
    rng = np.random.default_rng(7)
    texels = rng.random((4, 6, 2))
    uv = np.array([[-3.0, 0.3], [0.01, 0.3], [0.999, 0.3], [50.0, 0.3], [-np.inf, 0.3], [np.inf, 0.3]])
    inside = np.array([[0.5 / 6, 0.3]] * 2 + [[5.5 / 6, 0.3]] * 2 + [[0.5 / 6, 0.3], [5.5 / 6, 0.3]])
    np.testing.assert_allclose(sample([texels], uv, 0, ("clamp", "wrap")), sample([texels], inside, 0), rtol=1e-14)
    flipped = texels.transpose(1, 0, 2)
    out = sample([flipped], uv[:, ::-1], 0, ("wrap", "clamp"))
    np.testing.assert_allclose(out, sample([texels], inside, 0), rtol=1e-14)


def test_wrapped_lookups_are_continuous_and_periodic() -> None:
    rng = np.random.default_rng(8)
    texels = rng.random((5, 7, 3))
    border = np.stack([np.zeros(9), rng.random(9)], -1)
    step = np.array([1e-9, 0])
    for axis in (slice(None), slice(None, None, -1)):
        before, after = sample([texels], (border - step)[:, axis], 0), sample([texels], (border + step)[:, axis], 0)
        np.testing.assert_allclose(before, after, rtol=0, atol=1e-7)
        middle = sample([texels], border[:, axis], 0)
        edges = (before + after) / 2
        np.testing.assert_allclose(middle, edges, rtol=0, atol=1e-7)
    # Halves and quarters stay exact in float64 when whole numbers are added.
    uv = rng.integers(0, 64, (40, 2)) / 64
    for shift in ([1, 0], [-1, 2], [-1000, 4096], [10**6, -(10**9)]):
        np.testing.assert_array_equal(sample([texels], uv + shift, 0), sample([texels], uv, 0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("wrap", WRAPS)
def test_extreme_and_undefined_coordinates(wrap: tuple[str, str], dtype: Any) -> None:
    levels = [np.ones((h, w, 3), dtype) for h, w in ((5, 4), (2, 2))]
    big = np.finfo(dtype).max
    finite = np.array([0.0, -0.0, big, -big, np.finfo(dtype).tiny, 2.0**31, -(2.0**63), 1 - 2.0**-24], dtype)
    uv = np.stack(np.meshgrid(finite, finite), -1).reshape(-1, 2)
    np.testing.assert_array_equal(sample(levels, uv, 0.5, wrap), 1)
    for bad in (np.nan, np.inf, -np.inf):
        for axis in (0, 1):
            uv = np.full((1, 2), 0.4, dtype)
            uv[0, axis] = bad
            undefined = np.isnan(bad) or wrap[axis] == "wrap"
            assert np.all(np.isnan(sample(levels, uv, 0.5, wrap)) == undefined)
    assert np.all(np.isnan(sample(levels, np.full((1, 2), 0.4, dtype), np.nan, wrap)))
    assert np.all(sample(levels, np.full((1, 2), 0.4, dtype), -np.inf, wrap) == 1)


def test_other_levels_never_leak_in() -> None:
    levels = [np.full((4, 4, 2), np.nan), np.ones((2, 2, 2)), np.full((1, 1, 2), np.inf)]
    assert np.all(sample(levels, np.random.default_rng(0).random((20, 2)), 1.0) == 1)


def test_views_are_read_in_place() -> None:
    rng = np.random.default_rng(9)
    atlas = rng.random((3, 40, 50, 9), np.float32)
    for view in (atlas[:, 5:20, 10:33], atlas[:, ::-1, ::2], atlas[..., 2:6], atlas[::-1], atlas.swapaxes(1, 2)):
        whole = np.ascontiguousarray(view)
        uv = rng.random((60, 2))
        np.testing.assert_array_equal(sample([view], uv, 0.0), sample([whole], uv, 0.0))
    for copied in (atlas[..., ::-1], np.asfortranarray(atlas)):
        np.testing.assert_array_equal(sample([copied], uv, 0.0), sample([np.ascontiguousarray(copied)], uv, 0.0))
    frozen = atlas.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(sample([frozen], uv, 0.0), sample([atlas], uv, 0.0))
    packed = np.frombuffer(b"\0" + atlas.tobytes(), np.float32, offset=1).reshape(atlas.shape)
    np.testing.assert_array_equal(sample([packed], uv, 0.0), sample([atlas], uv, 0.0))


def test_no_lookups_give_an_empty_result() -> None:
    assert sample([np.ones((2, 2, 5))], np.empty((0, 2)), 0.0).shape == (0, 5)
    assert sample([np.ones((3, 2, 2, 5))], np.empty((0, 2)), np.empty(0)).shape == (3, 0, 5)


def test_plain_numbers_and_lists_are_coordinates() -> None:
    level = np.arange(4.0).reshape(1, 4, 1)
    np.testing.assert_array_equal(sample([level], [[0.125, 0.5], [0.375, 0.5]], 0), [[0], [1]])
    np.testing.assert_array_equal(sample((level,), [[0, 0]], 0), [[1.5]])


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_values_do_not_depend_on_the_number_of_threads(threads: int) -> None:
    rng = np.random.default_rng(10)
    levels = [rng.random((2, h, w, 4), np.float32) for h, w in ((300, 200), (150, 100))]
    uv, lod = rng.normal(0, 1, (2, 9001, 2)), rng.uniform(0, 1, 9001)
    default = _native.num_threads()
    try:
        _native.set_num_threads(1)
        alone = sample(levels, uv, lod)
        _native.set_num_threads(threads)
        np.testing.assert_array_equal(sample(levels, uv, lod), alone)
    finally:
        _native.set_num_threads(default)


LEVEL, UV = np.ones((4, 4, 3), np.float32), np.zeros((5, 2))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((LEVEL, UV, 0), "levels is a ndarray: expected a list"),
        ((None, UV, 0), "levels is a NoneType: expected a list"),
        (([], UV, 0), "levels has 0 items: expected 1 to 32"),
        (([LEVEL] * 33, UV, 0), "levels has 33 items: expected 1 to 32"),
        (([LEVEL, LEVEL.astype(np.float64)], UV, 0), r"levels\[1\] is float64: expected .* levels\[0\] \(float32\)"),
        (([LEVEL.astype(np.uint8)], UV, 0), r"levels\[0\] is uint8: expected float32 or float64"),
        (([LEVEL[0]], UV, 0), r"levels\[0\] has shape \(4, 3\): expected \(H, W, C\)"),
        (([LEVEL, LEVEL[:0]], UV, 0), r"levels\[1\] has shape \(0, 4, 3\): expected"),
        (([LEVEL, LEVEL[..., :2]], UV, 0), r"levels\[1\] has shape .* expected the same batch and the same channels"),
        (([LEVEL, LEVEL[None]], UV, 0), r"levels\[1\] has shape .* expected the same batch and the same channels"),
        (([LEVEL], np.zeros((5, 3)), 0), r"uv has shape \(5, 3\): expected \(P, 2\) or \(B, P, 2\)"),
        (([LEVEL], np.zeros(2), 0), r"uv has shape \(2,\): expected"),
        (([LEVEL], UV.astype(complex), 0), "uv is complex128: expected real numbers"),
        (([LEVEL], "here", 0), "uv is <U4: expected real numbers"),
        (([LEVEL], [[0, 0], [1]], 0), "uv is not an array of numbers"),
        (([LEVEL], UV, np.zeros(4)), r"lod has shape \(4,\): expected a scalar, .* P = 5"),
        (([LEVEL], UV, np.zeros((1, 1, 5))), r"lod has shape \(1, 1, 5\): expected"),
        (([LEVEL], UV, None), "lod is object: expected real numbers"),
        (([LEVEL], UV, True), "lod is bool: expected real numbers"),
        (([LEVEL[None].repeat(2, 0)], np.zeros((3, 5, 2)), 0), "batch sizes do not fit: levels has 2, uv has 3"),
        (([LEVEL], np.zeros((3, 5, 2)), np.zeros((2, 5))), "batch sizes do not fit: uv has 3, lod has 2"),
        (([LEVEL], UV, 0, "wrap"), "wrap is 'wrap': expected a pair"),
        (([LEVEL], UV, 0, ("wrap", "mirror")), "wrap is .*: expected a pair of 'wrap' or 'clamp'"),
        (([LEVEL], UV, 0, ("wrap",)), "wrap is .*: expected a pair"),
        (([LEVEL], UV, 0, None), "wrap is None: expected a pair"),
    ],
)
def test_wrong_arguments_are_named(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        sample(*arguments)
