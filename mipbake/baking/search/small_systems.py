"""Many small systems of linear equations with symmetric matrices, solved side by side.

NumPy's own solvers call a library once for each matrix, and raise where one of them is not positive definite. Here a
step of Cholesky's method is one operation on all matrices at once, whose axis comes last: what is small are the
matrices, and what is long is their row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.floating]


def factored(matrices: Reals) -> Reals:
    """(P, P, B) lower triangular factors L of (B, P, P) symmetric matrices L L^T; what is above the diagonal is 0.

    The upper halves of the matrices are not read. Factors hold NaN where a matrix is not positive definite.
    """
    rest = np.ascontiguousarray(np.moveaxis(matrices, 0, -1))
    factors = np.zeros_like(rest)
    with np.errstate(all="ignore"):
        for j in range(len(rest)):
            column = rest[j:, j] - np.einsum("ikb,kb->ib", factors[j:, :j], factors[j, :j])
            factors[j:, j] = column / np.sqrt(column[0])
    return factors


def solved(factors: Reals, right: Reals) -> Reals:
    """(B, P) solutions of the equations of `factored` with (B, P) right sides; 0 where a matrix has none."""
    out = np.array(right.T, order="C")
    with np.errstate(all="ignore"):
        for j in range(len(out)):
            out[j] -= np.einsum("kb,kb->b", factors[j, :j], out[:j])
            out[j] /= factors[j, j]
        for j in reversed(range(len(out))):
            out[j] -= np.einsum("kb,kb->b", factors[j + 1 :, j], out[j + 1 :])
            out[j] /= factors[j, j]
    return np.asarray(np.where(np.isfinite(out), out, 0).T)
