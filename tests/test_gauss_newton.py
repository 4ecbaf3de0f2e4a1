"""The optimiser that blends and texels share."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mipbake.prefilter.search.gauss_newton import System, accepted, signs

BLOCKS, UNKNOWNS = 5, 3
FREE = torch.full((UNKNOWNS,), -torch.inf, dtype=torch.float64), torch.full((UNKNOWNS,), torch.inf, dtype=torch.float64)


def quadratic(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """(B, P, P) curvatures and (B, P) least values of as many quadratic functions."""
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(BLOCKS, UNKNOWNS, UNKNOWNS, generator=generator, dtype=torch.float64)
    lowest = 0.3 * torch.rand(BLOCKS, UNKNOWNS, generator=generator, dtype=torch.float64)
    return root @ root.mT + torch.eye(UNKNOWNS, dtype=torch.float64), lowest


def system(curvature: torch.Tensor, start: torch.Tensor, **changes: object) -> System:
    arguments = {"held": None, "unit": torch.ones_like(start), "limits": FREE, "damping": 1e-9} | changes
    return System(start, curvature, **arguments)  # type: ignore[arg-type]


def slope(curvature: torch.Tensor, lowest: torch.Tensor, here: torch.Tensor) -> torch.Tensor:
    return (curvature @ (here - lowest)[..., None])[..., 0]


def test_a_step_on_quadratics_ends_at_their_lowest_points() -> None:
    curvature, lowest = quadratic()
    here = torch.zeros_like(lowest)
    found = system(curvature, here).stepped(here, slope(curvature, lowest, here))
    assert found.numpy() == pytest.approx(lowest.numpy(), abs=5e-3)  # damping floors


def test_no_step_is_longer_than_a_unit() -> None:
    curvature, lowest = quadratic()
    here, unit = torch.zeros_like(lowest), torch.full_like(lowest, 1e-3)
    found = system(curvature, here, unit=unit).stepped(here, slope(curvature, lowest, here))
    assert found.abs().max() <= 1e-3 * (1 + 1e-9)


def test_unknowns_at_a_limit_stay_and_the_others_find_the_best_beside_it() -> None:
    curvature, lowest = quadratic()
    here = torch.zeros_like(lowest)
    limits = (torch.full((UNKNOWNS,), -10.0, dtype=torch.float64), torch.tensor([0.0, 10, 10], dtype=torch.float64))
    pull = slope(curvature, lowest, here)
    found = system(curvature, here, limits=limits).stepped(here, pull)
    stopped = pull[:, 0] < 0
    assert stopped.any() and (found[stopped, 0] == 0).all() and (found[:, 0] <= 0).all()
    rest = slope(curvature, lowest, found)[stopped][:, 1:]
    assert rest.abs().max() < 0.05 * pull.abs().max()


def test_what_holds_unknowns_pulls_them_back() -> None:
    curvature, lowest = quadratic()
    start = torch.zeros_like(lowest)
    held = system(curvature, start, held=curvature)
    here = held.stepped(start, slope(curvature, lowest, start))
    here = held.stepped(here, slope(curvature, lowest, here))
    assert here.numpy() == pytest.approx(lowest.numpy() / 2, abs=5e-3)
    away = here[..., None]
    assert held.energy(here) == pytest.approx(0.5 * float((away.mT @ curvature @ away).sum()))


def test_a_step_is_damped_until_the_value_falls() -> None:
    """The curvature is a hundred times too small: whole steps lead far beyond the lowest point."""
    curvature, lowest = quadratic()
    here = lowest + 0.02

    def value(at: torch.Tensor) -> float:
        return 0.5 * float(((at - lowest)[..., None].mT @ curvature @ (at - lowest)[..., None]).sum())

    weak = system(curvature / 100, here)
    step = accepted(weak, here, slope(curvature, lowest, here), value, value(here), 1.0)
    assert step is not None
    found, now, damping = step
    assert now == pytest.approx(value(found)) and now < value(here) and damping > 1
    assert accepted(weak, lowest, torch.ones_like(lowest), value, 0.0, 1e-3) is None


def test_random_signs_give_the_curvature_in_the_mean() -> None:
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(6, 4))
    rows = signs((20000, 6), rng) @ jacobian
    assert rows.T @ rows / len(rows) == pytest.approx(jacobian.T @ jacobian, abs=0.25)
