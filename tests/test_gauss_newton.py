"""The optimiser that blends and texels share, and its many small systems of equations."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.baking.search.gauss_newton import System, accepted, factored, signs, solved

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
    return System(start, curvature, **arguments)


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


@pytest.mark.parametrize("end", [-1, 1])
def test_unknowns_at_a_limit_stay_and_the_others_find_the_best_beside_it(end: int) -> None:
    curvature, lowest = quadratic()
    here, lowest = np.zeros_like(lowest), end * lowest
    limits = np.sort([np.full(UNKNOWNS, -10.0 * end), end * np.array([0.0, 10, 10])], 0)
    pull = slope(curvature, lowest, here)
    found = system(curvature, here, limits=(limits[0], limits[1])).stepped(here, pull)
    stopped = end * pull[:, 0] < 0
    assert stopped.any() and (found[stopped, 0] == 0).all() and (end * found[:, 0] <= 0).all()
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
    found, now, damping = step
    assert now == pytest.approx(value(found)) and now < value(here) and damping > 1
    assert accepted(weak, lowest, np.ones_like(lowest), value, 0.0, 1e-3) is None


def test_random_signs_give_the_curvature_in_the_mean() -> None:
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(6, 4))
    rows = signs((20000, 6), rng) @ jacobian
    assert rows.T @ rows / len(rows) == pytest.approx(jacobian.T @ jacobian, abs=0.25)


SYSTEMS = 40


def systems(size: int, dtype: type) -> tuple[np.ndarray, np.ndarray]:
    """Positive definite (B, P, P) matrices, and (B, P) right sides."""
    rng = np.random.default_rng(size)
    roots = rng.standard_normal((SYSTEMS, size, 2 * size))
    return (roots @ roots.swapaxes(1, 2)).astype(dtype), rng.standard_normal((SYSTEMS, size)).astype(dtype)


@pytest.mark.parametrize(("dtype", "near"), [(np.float64, 1e-12), (np.float32, 2e-5)])
@pytest.mark.parametrize("size", [1, 2, 7, 12, 20])
def test_factors_and_solutions_are_right(size: int, dtype: type, near: float) -> None:
    matrices, right = systems(size, dtype)
    factors = factored(matrices)
    assert factors.dtype == dtype and factors.shape == (size, size, SYSTEMS)
    np.testing.assert_allclose(np.moveaxis(factors, -1, 0), np.linalg.cholesky(matrices), rtol=1e2 * near, atol=near)
    found = solved(factors, right)
    assert found.dtype == dtype and found.shape == right.shape
    np.testing.assert_allclose((matrices @ found[..., None])[..., 0], right, atol=1e2 * near)


def test_a_matrix_that_is_not_positive_definite_has_no_solution_and_spoils_no_other() -> None:
    matrices, right = systems(3, np.float64)
    good = solved(factored(matrices), right)
    matrices[1] = -np.eye(3)
    matrices[2] = 0
    matrices[3, 2, 1] = np.nan
    matrices[4, 0, 0] = np.inf
    matrices[5] = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]  # eigenvalues 3, -1, 1
    found = solved(factored(matrices), right)
    assert np.isfinite(found).all()
    assert not found[[1, 2, 3, 5]].any()
    assert np.array_equal(np.delete(found, range(1, 6), 0), np.delete(good, range(1, 6), 0))
