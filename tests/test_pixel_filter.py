"""Pixel filters and polyphase resampling, and the native kernel beside its plain twin: the same bits."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake import _native
from mipbake.base.errors import UsageError
from mipbake.material import pixel_filter as pf

# Second moments in pixel^2, from the filters' formulas.
VARIANCE = {"gaussian": 0.25, "box": 1 / 12, "tent": 1 / 6}


@pytest.mark.parametrize("name", pf.FILTERS)
def test_offsets_are_an_unbiased_importance_sampling(name: str) -> None:
    kernel = pf.FILTERS[name]
    u = (np.arange(200_000) + 0.5) / 200_000
    x, weight = kernel.offsets(u)
    assert np.abs(x).max() <= kernel.radius
    assert weight.mean() == pytest.approx(1, abs=1e-3)
    assert (weight * x).mean() == pytest.approx(0, abs=1e-3)
    grid = np.linspace(-kernel.radius, kernel.radius, 20_001)
    density = kernel.shape(grid) / np.trapezoid(kernel.shape(grid), grid)
    expected = np.trapezoid(density * np.cos(grid), grid)
    assert (weight * np.cos(x)).mean() == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("name", VARIANCE)
def test_variance(name: str) -> None:
    x, weight = pf.FILTERS[name].offsets((np.arange(100_000) + 0.5) / 100_000)
    # The gaussian is cut at four sigma, which takes a thousandth off its variance.
    assert (weight * x * x).mean() == pytest.approx(VARIANCE[name], rel=2e-3)


def test_blackman_harris_is_the_window_of_its_paper() -> None:
    """Harris 1978, table 1 and figure 24: four terms, minimum side lobes of -92 dB, here over -2 to 2. The sum of the
    coefficients is the middle, alternating they are the ends, and a0 - a2 is what lies halfway."""
    a0, a1, a2, a3 = 0.35875, 0.48829, 0.14128, 0.01168
    kernel = pf.FILTERS["blackman-harris"]
    x = np.array([0.0, 2.0, -2.0, 1.0, -1.0, 2 / 3])
    middle, end = a0 + a1 + a2 + a3, a0 - a1 + a2 - a3
    third = a0 + a1 / 2 - a2 / 2 - a3  # cosines of 60, 120 and 180 degrees
    expected = [middle, end, end, a0 - a2, a0 - a2, third]
    assert kernel.radius == 2
    assert kernel.shape(x) == pytest.approx(expected, abs=1e-12)
    assert middle == pytest.approx(1) and end == pytest.approx(6e-5)
    count = 256
    spectrum = np.abs(np.fft.rfft(kernel.shape(-2 + 4 * np.arange(count) / count), 64 * count))
    side_lobes = spectrum[4 * 64 :]  # beyond the main lobe, which ends four bins from its middle
    assert 20 * np.log10(side_lobes.max() / spectrum[0]) == pytest.approx(-92, abs=0.1)


def test_mitchell_is_negative_where_its_paper_says() -> None:
    shape = pf.FILTERS["mitchell"].shape
    assert shape(np.array([0.0, 1.0, 2.0])) == pytest.approx([8 / 9, 1 / 18, 0])
    # Equation 8 with B = C = 1/3, worked out by hand: (7/8 - 12/4 + 16/3) / 6 and (-63/8 + 27 - 30 + 32/3) / 6.
    assert shape(np.array([-0.5, 0.5, 1.5])) == pytest.approx([77 / 144, 77 / 144, -5 / 144])


def test_box_on_odd_sizes_weighs_by_area() -> None:
    five = np.array([1, 0, 0, 0, 0], np.float32).reshape(1, 5, 1)
    # Two outputs of 2.5 texels each: the first texel is 1 / 2.5 of the first.
    assert pf.resample(five, (1, 2), "box", ("wrap", "wrap"))[0, :, 0] == pytest.approx([0.4, 0.0])


def test_sizes_and_names() -> None:
    assert pf.level_sizes(5, 12) == [(5, 12), (2, 6), (1, 3), (1, 1)]
    with pytest.raises(UsageError, match=r"'sinc'.*gaussian, box, tent"):
        pf.filter_named("sinc")


def test_box_halves_even_sizes_like_a_two_by_two_average() -> None:
    image = np.random.default_rng(0).random((6, 8, 3), dtype=np.float32)
    expected = image.reshape(3, 2, 4, 2, 3).mean((1, 3))
    assert pf.resample(image, (3, 4), "box", ("wrap", "clamp")) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("name", pf.FILTERS)
@pytest.mark.parametrize("size", [(37, 20), (1, 9)])
def test_a_constant_stays_constant_on_every_level(name: str, size: tuple[int, int]) -> None:
    image = np.full((*size, 2), 0.37, np.float32)
    levels = pf.filtered_levels(image, name, ("wrap", "clamp"))
    assert [level.shape[:2] for level in levels] == pf.level_sizes(*size)
    assert levels[-1].shape[:2] == (1, 1)
    for level in levels:
        assert level == pytest.approx(np.full_like(level, 0.37), abs=2e-6)


def test_a_gaussian_level_has_the_variance_of_its_footprint() -> None:
    """An impulse filtered to level 3 spreads by sigma 0.5 pixel = 4 texels, plus the texel's own extent."""
    n, level = 256, 3
    spread = []
    for position in range(8):
        image = np.zeros((1, n, 1), np.float32)
        image[0, 128 + position] = 1
        out = pf.filtered_levels(image, "gaussian", ("clamp", "clamp"))[level][0, :, 0]
        centre = (np.arange(len(out)) + 0.5) * 2**level
        mean = (out * centre).sum() / out.sum()
        spread.append((out * (centre - mean) ** 2).sum() / out.sum())
    assert np.mean(spread) == pytest.approx((0.5 * 8) ** 2 + 1 / 12, rel=0.02)


@pytest.mark.parametrize("wrap", [("clamp", "clamp"), ("wrap", "clamp")])
def test_coarse_levels_of_clamped_axes_repeat_the_edge_texel(wrap: tuple[str, str]) -> None:
    """Beyond a clamped border lies the edge texel for ever, on every level."""
    image = np.random.default_rng(0).random((64, 64, 1), dtype=np.float32)
    image[0], image[:, -1] = 3, -2
    for level, out in enumerate(pf.filtered_levels(image, "gaussian", wrap)):
        expected = pf.resample(image, (64 >> level, 64 >> level), "gaussian", wrap)
        assert out == pytest.approx(expected, abs=2e-5 if wrap[0] == "clamp" else 2e-2)


# ---- the native kernel


def plain_resample(image: np.ndarray, rows: pf.Taps, columns: pf.Taps) -> np.ndarray:
    """(H, W, C) to (h, w, C), as mipbake.material.pixel_filter.resample_taps."""
    combined = along_rows(image, rows)
    return np.ascontiguousarray(along_rows(combined.swapaxes(0, 1), columns).swapaxes(0, 1))


def along_rows(image: np.ndarray, taps: pf.Taps) -> np.ndarray:
    index, weights = taps
    if index.shape[1] == 1:
        return image[index[:, 0]]
    out = np.zeros((len(index), *image.shape[1:]), np.float32)
    for tap in range(index.shape[1]):
        out += image[index[:, tap]] * weights[:, tap, None, None]
    return out


SIZES = st.integers(1, 40)


@settings(max_examples=60, deadline=None)
@given(
    size=st.tuples(SIZES, SIZES),
    shrink=st.tuples(st.integers(0, 6), st.integers(0, 6)),
    channels=st.integers(1, 37),
    name=st.sampled_from(list(pf.FILTERS)),
    wrap=st.tuples(*[st.sampled_from(["wrap", "clamp"])] * 2),
    width=st.sampled_from([1.0, 2.0]),
)
def test_any_sizes_and_channels_have_the_bits_of_the_plain_twin(size, shrink, channels, name, wrap, width):
    image = np.random.default_rng(channels).standard_normal((*size, channels), np.float32)
    rows, columns = (
        pf.resample_weights(n, max(1, n >> by), name, mode, width)
        for n, by, mode in zip(size, shrink, wrap[::-1], strict=True)
    )
    expected = plain_resample(image, rows, columns)
    np.testing.assert_array_equal(pf.resample_taps(image, rows, columns), expected)
    out = pf.resample(image, (len(rows[0]), len(columns[0])), name, wrap, width)
    np.testing.assert_array_equal(out, expected)


def test_the_number_of_threads_changes_no_bit() -> None:
    image = np.random.default_rng(1).standard_normal((301, 257, 9), np.float32)
    before = _native.num_threads()
    found = []
    try:
        for count in (1, 2, 7):
            _native.set_num_threads(count)
            found.append([pf.resample(image, size, "gaussian", ("wrap", "clamp")) for size in ((301, 257), (37, 32))])
    finally:
        _native.set_num_threads(before)
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


def test_rows_may_lie_apart_and_channels_too() -> None:
    whole = np.random.default_rng(2).standard_normal((24, 32, 8), np.float32)
    for part in (whole[::2], whole[:, 4:20], whole[..., 2:5], whole[::-1], whole.swapaxes(0, 1)):
        size = (part.shape[0] // 2, part.shape[1] // 2)
        expected = pf.resample(np.ascontiguousarray(part), size, "tent", ("wrap", "wrap"))
        np.testing.assert_array_equal(pf.resample(part, size, "tent", ("wrap", "wrap")), expected)


def test_what_is_not_finite_reaches_only_its_own_channel_and_footprint() -> None:
    """Lanes beyond a texel's channels are computed and thrown away."""
    image = np.ones((16, 16, 3), np.float32)
    image[4, 15, 2] = np.nan
    out = pf.resample(image, (8, 8), "box", ("wrap", "wrap"))
    assert np.isnan(out[2, 7, 2])
    assert np.isnan(out).sum() == 1


def test_the_binding_refuses_what_would_read_beyond_an_array() -> None:
    image, out = np.zeros((4, 4, 1), np.float32), np.zeros((4, 4, 1), np.float32)
    index, weights = np.arange(4).reshape(4, 1), np.ones((4, 1), np.float32)
    _native.resample(image, index, weights, index, weights, out)
    for bad in (index + 1, index - 1):
        with pytest.raises(ValueError, match="out of range"):
            _native.resample(image, bad, weights, index, weights, out)
        with pytest.raises(ValueError, match="out of range"):
            _native.resample(image, index, weights, bad, weights, out)
    with pytest.raises(ValueError, match="out"):
        _native.resample(image, index, weights, index, weights, out[:3])
    with pytest.raises(ValueError, match="side by side"):
        _native.resample(image[:, ::2], index, weights, index, weights, out)


WITHOUT_THREADS = """
import re, resource
from pathlib import Path
import numpy as np
from mipbake import _native

image = np.random.default_rng(0).random((512, 512, 3), np.float32)
out, rows, weights = np.zeros((256, 256, 3), np.float32), np.arange(512).reshape(256, 2), np.full((256, 2), 0.5)
arguments = (image, rows, weights.astype(np.float32), rows, weights.astype(np.float32), out)
_native.set_num_threads(1)
_native.resample(*arguments)
wanted, out[...] = out.copy(), 0
_native.set_num_threads(4)
now = int(re.search(r"VmSize:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) << 10
resource.setrlimit(resource.RLIMIT_AS, (now + (1 << 20), resource.RLIM_INFINITY))  # less than the stack of a thread
_native.resample(*arguments)
resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
assert np.array_equal(out, wanted)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit address space")
def test_a_loop_does_without_threads_that_the_system_refuses() -> None:
    subprocess.run([sys.executable, "-c", WITHOUT_THREADS], check=True)
