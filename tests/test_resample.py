"""The native resampling beside its plain twin: the same bits."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mipbake import _native
from mipbake.material import pixel_filter as pf

from .plain_resample import plain_resample

SIZES = st.integers(1, 70)


@settings(max_examples=150, deadline=None)
@given(
    size=st.tuples(SIZES, SIZES),
    shrink=st.tuples(st.integers(0, 6), st.integers(0, 6)),
    channels=st.integers(1, 37),
    name=st.sampled_from(list(pf.FILTERS)),
    wrap=st.tuples(*[st.sampled_from(["wrap", "clamp"])] * 2),
    width=st.sampled_from([1.0, 2.0]),
)
def test_any_sizes_and_channels_have_the_bits_of_the_plain_twin(
    size: tuple[int, int], shrink: tuple[int, int], channels: int, name: str, wrap: pf.Wrap, width: float
) -> None:
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
