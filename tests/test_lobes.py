"""Directions around lobes: they are drawn with the densities that are given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mipbake.quality.metrics.pairs import NEAR_MIRROR_SPREAD, cosine_directions, near_mirror_lights
from mipbake.quality.reference import lobes


def sphere(count: int) -> np.ndarray:
    """(count, 3) directions spread evenly over the upper hemisphere (Fibonacci)."""
    z = (np.arange(count) + 0.5) / count
    angle = np.arange(count) * (np.pi * (3 - 5**0.5))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).astype(np.float32)


@pytest.mark.parametrize(("height", "alpha"), [(1.0, 0.2), (0.6, 0.3), (0.3, 0.3), (0.6, 0.9)])
@pytest.mark.parametrize("cosine", [0.95, 0.4])
def test_densities_of_lobes_integrate_to_what_is_drawn(height: float, alpha: float, cosine: float) -> None:
    """Lights above the horizon: the share of those drawn is the integral of the density, tilted lobes included."""
    rng = np.random.default_rng(0)
    lobe = np.array([[(1 - height**2) ** 0.5, 0.0, height, alpha]], np.float32)
    view = np.array([-((1 - cosine**2) ** 0.5), 0.0, cosine], np.float32)
    count = 200_000
    u, v = rng.random((count, 1), np.float32), rng.random((count, 1), np.float32)
    drawn = lobes.reflected(np.broadcast_to(view, (count, 1, 3)), lobes.half_vectors(lobe, u, v))
    assert drawn.dtype == np.float32
    share = float((drawn[..., 2] > 0).mean())
    even = sphere(200_000)[:, None]
    integral = float(lobes.lobe_density(lobe, even, np.broadcast_to(view, even.shape)).mean()) * 2 * np.pi
    assert integral == pytest.approx(share, rel=0.02, abs=2e-3)
    # Not only the whole: also the part near the plane of the view.
    part = float(((drawn[..., 2] > 0) & (np.abs(drawn[..., 1]) < 0.2)).mean())
    some = lobes.lobe_density(lobe, even, np.broadcast_to(view, even.shape)) * (np.abs(even[..., 1]) < 0.2)
    assert float(some.mean()) * 2 * np.pi == pytest.approx(part, rel=0.03, abs=2e-3)


def test_densities_of_the_pair_sets_integrate_to_one() -> None:
    even = sphere(100_000)
    for cosine in (0.98, 0.5, 0.1):
        view = np.broadcast_to(np.array([(1 - cosine**2) ** 0.5, 0.0, cosine], np.float32), even.shape)
        assert float(lobes.near_mirror_density(even, view).mean()) * 2 * np.pi == pytest.approx(1, abs=0.01)
    assert float(lobes.hemisphere_density(even).mean()) * 2 * np.pi == pytest.approx(1, abs=1e-3)
    rng = np.random.default_rng(0)
    views = cosine_directions(rng, 20_000)
    lights = near_mirror_lights(rng, views)
    found = lobes.near_mirror_density(lights.astype(np.float32), views.astype(np.float32))
    assert found.dtype == np.float32 and np.isfinite(found).all() and np.median(found) > 1


def test_lights_that_are_drawn_again_count_as_many_as_lie_above_the_horizon() -> None:
    """The two densities around the mirror direction differ by what of a Gaussian lies above the horizon."""
    cosine = np.linspace(0, 1, 4001, dtype=np.float32)
    view = np.stack([np.sqrt(1 - cosine * cosine), np.zeros_like(cosine), cosine], -1)
    mirror = view * np.float32([-1, -1, 1])
    kept = lobes.around_mirror_density(mirror, view) / lobes.near_mirror_density(mirror, view)
    wanted = [0.5 * math.erfc(-float(each) / NEAR_MIRROR_SPREAD / math.sqrt(2)) for each in cosine]
    np.testing.assert_allclose(kept, wanted, rtol=0, atol=3e-7)
