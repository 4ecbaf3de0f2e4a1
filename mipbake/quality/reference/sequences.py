"""Where pixels lie: an additive recurrence of low discrepancy under a random shift."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SEQUENCE = np.array([0.7548776662466927, 0.5698402909980532])
"""Additive recurrence of low discrepancy (Roberts 2018): powers of 1 / plastic number."""


def random_points(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count, 2) texture coordinates: a low-discrepancy sequence with a random shift, at random sub-texel offsets."""
    return np.asarray((rng.random(2) + np.arange(count)[:, None] * SEQUENCE) % 1.0)
