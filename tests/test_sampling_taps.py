"""Lookups in images of which only some texels are known: the bits of the kernel."""

import numpy as np
import pytest

from mipbake import sampling
from mipbake.sampling.taps import linear_taps


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
