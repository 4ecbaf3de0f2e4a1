"""The optimiser that blends and texels share."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.baking.search.gauss_newton import System, accepted, signs

BLOCKS, UNKNOWNS = 5, 3
FREE = np.full(UNKNOWNS, -np.inf), np.full(UNKNOWNS, np.inf)


def quadratic(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(B, P, P) curvatures and (B, P) least values of as many quadratic functions."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((BLOCKS, UNKNOWNS, UNKNOWNS))
    lowest = 0.3 * rng.random((BLOCKS, UNKNOWNS))
    return root @ root.swapaxes(1, 2) + np.eye(UNKNOWNS), lowest


def system(curvature: np.ndarray, start: np.ndarray, **changes: object) -> System:
    arguments = {"held": None, "unit": np.ones_like(start), "limits": FREE, "damping": 1e-9} | changes
    return System(start, curvature, **arguments)  # type: ignore[arg-type]


def slope(curvature: np.ndarray, lowest: np.ndarray, here: np.ndarray) -> np.ndarray:
    return (curvature @ (here - lowest)[..., None])[..., 0]


def test_a_step_on_quadratics_ends_at_their_lowest_points() -> None:
    curvature, lowest = quadratic()
    here = np.zeros_like(lowest)
    found = system(curvature, here).stepped(here, slope(curvature, lowest, here))
    assert found == pytest.approx(lowest, abs=5e-3)  # damping floors


def test_no_step_is_longer_than_a_unit() -> None:
    curvature, lowest = quadratic()
    here, unit = np.zeros_like(lowest), np.full_like(lowest, 1e-3)
    found = system(curvature, here, unit=unit).stepped(here, slope(curvature, lowest, here))
    assert np.abs(found).max() <= 1e-3 * (1 + 1e-9)


def test_unknowns_at_a_limit_stay_and_the_others_find_the_best_beside_it() -> None:
    curvature, lowest = quadratic()
    here = np.zeros_like(lowest)
    limits = np.full(UNKNOWNS, -10.0), np.array([0.0, 10, 10])
    pull = slope(curvature, lowest, here)
    found = system(curvature, here, limits=limits).stepped(here, pull)
    stopped = pull[:, 0] < 0
    assert stopped.any() and (found[stopped, 0] == 0).all() and (found[:, 0] <= 0).all()
    rest = slope(curvature, lowest, found)[stopped][:, 1:]
    assert np.abs(rest).max() < 0.05 * np.abs(pull).max()


def test_what_holds_unknowns_pulls_them_back() -> None:
    curvature, lowest = quadratic()
    start = np.zeros_like(lowest)
    held = system(curvature, start, held=curvature)
    here = held.stepped(start, slope(curvature, lowest, start))
    here = held.stepped(here, slope(curvature, lowest, here))
    assert here == pytest.approx(lowest / 2, abs=5e-3)
    away = here[..., None]
    assert held.energy(here) == pytest.approx(0.5 * float((away.swapaxes(1, 2) @ curvature @ away).sum()))


def test_a_step_is_damped_until_the_value_falls() -> None:
    """The curvature is a hundred times too small: whole steps lead far beyond the lowest point."""
    curvature, lowest = quadratic()
    here = lowest + 0.02

    def value(at: np.ndarray) -> float:
        return 0.5 * float(((at - lowest)[..., None].swapaxes(1, 2) @ curvature @ (at - lowest)[..., None]).sum())

    weak = system(curvature / 100, here)
    step = accepted(weak, here, slope(curvature, lowest, here), value, value(here), 1.0)
    assert step is not None
    found, now, damping = step
    assert now == pytest.approx(value(found)) and now < value(here) and damping > 1
    assert accepted(weak, lowest, np.ones_like(lowest), value, 0.0, 1e-3) is None


def test_random_signs_give_the_curvature_in_the_mean() -> None:
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(6, 4))
    rows = signs((20000, 6), rng) @ jacobian
    assert rows.T @ rows / len(rows) == pytest.approx(jacobian.T @ jacobian, abs=0.25)
