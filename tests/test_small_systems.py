"""Many small systems of equations at once: NumPy's own solver is what they are held against."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.baking.search.gauss_newton import factored, solved

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


def test_the_arguments_stay_as_they_are() -> None:
    matrices, right = systems(5, np.float64)
    before = matrices.copy(), right.copy()
    solved(factored(matrices), right)
    assert np.array_equal(matrices, before[0]) and np.array_equal(right, before[1])


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


def test_there_may_be_none() -> None:
    assert solved(factored(np.zeros((0, 3, 3))), np.zeros((0, 3))).shape == (0, 3)
