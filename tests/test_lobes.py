"""Directions around lobes: they are drawn with the densities that are given."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mipbake.metrics.pairs import cosine_directions, near_mirror_lights
from mipbake.reference import lobes


def sphere(count: int) -> torch.Tensor:
    """(count, 3) directions spread evenly over the upper hemisphere (Fibonacci)."""
    z = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    angle = torch.arange(count, dtype=torch.float64) * (np.pi * (3 - 5**0.5))
    radius = (1 - z * z).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), z], -1).float()


@pytest.mark.parametrize(("height", "alpha"), [(1.0, 0.2), (0.6, 0.3), (0.3, 0.3), (0.6, 0.9)])
@pytest.mark.parametrize("cosine", [0.95, 0.4])
def test_densities_of_lobes_integrate_to_what_is_drawn(height: float, alpha: float, cosine: float) -> None:
    """Lights above the horizon: the share of those drawn is the integral of the density, tilted lobes included."""
    generator = torch.Generator().manual_seed(0)
    lobe = torch.tensor([[(1 - height**2) ** 0.5, 0.0, height, alpha]])
    view = torch.tensor([-((1 - cosine**2) ** 0.5), 0.0, cosine])
    count = 200_000
    u, v = torch.rand(count, 1, generator=generator), torch.rand(count, 1, generator=generator)
    drawn = lobes.reflected(view.expand(count, 1, 3), lobes.half_vectors(lobe, u, v))
    share = float((drawn[..., 2] > 0).float().mean())
    even = sphere(200_000)[:, None]
    integral = float(lobes.lobe_density(lobe, even, view.expand_as(even)).mean()) * 2 * np.pi
    assert integral == pytest.approx(share, rel=0.02, abs=2e-3)
    # Not only the whole: also the part near the plane of the view.
    part = float(((drawn[..., 2] > 0) & (drawn[..., 1].abs() < 0.2)).float().mean())
    some = lobes.lobe_density(lobe, even, view.expand_as(even)) * (even[..., 1].abs() < 0.2)
    assert float(some.mean()) * 2 * np.pi == pytest.approx(part, rel=0.03, abs=2e-3)


def test_densities_of_the_pair_sets_integrate_to_one() -> None:
    even = sphere(100_000)
    for cosine in (0.98, 0.5, 0.1):
        view = torch.tensor([(1 - cosine**2) ** 0.5, 0.0, cosine]).expand_as(even)
        assert float(lobes.near_mirror_density(even, view).mean()) * 2 * np.pi == pytest.approx(1, abs=0.01)
    assert float(lobes.hemisphere_density(even).mean()) * 2 * np.pi == pytest.approx(1, abs=1e-3)
    rng = np.random.default_rng(0)
    views = cosine_directions(rng, 20_000)
    lights = near_mirror_lights(rng, views)
    found = lobes.near_mirror_density(torch.from_numpy(lights).float(), torch.from_numpy(views).float())
    assert torch.isfinite(found).all() and float(found.median()) > 1
