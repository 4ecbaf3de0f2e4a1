"""Materials and efforts for the tests of searches, without torch."""

from __future__ import annotations

import numpy as np

from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.terms import PICTURES, TERMS, Weight, Weights, weights_for

WRAP = ("wrap", "wrap")
WEIGHTS = weights_for(0.5)
SEEN_ALONE = Weights({name: Weight(float(name in PICTURES), 0.0) for name in TERMS}, group_behind=0.0)
"""Weights of which nothing counts but pictures."""

SMALL = ProbeEffort(groups=8, points=48, samples=16, pictures=16, picture_samples=8)
EFFORT = ProbeEffort(groups=8, points=48, samples=8, pictures=16, picture_samples=4)
TINY = ProbeEffort(groups=2, points=8, samples=4, pictures=8, picture_samples=2)
SHORT = DescentEffort(rounds=5, pairs=16, samples=4, looks=ProbeEffort(groups=2, points=32, samples=4, pictures=8))
TWO_ROUNDS = DescentEffort(rounds=2, pairs=8, looks=ProbeEffort(groups=2, points=16, pictures=8, picture_samples=2))


def bumpy(height: int, width: int, roughness: float = 0.25, steep: float = 0.25) -> np.ndarray:
    """Bumps of one roughness and colour."""
    rng = np.random.default_rng(1)
    normal = np.concatenate([steep * rng.standard_normal((height, width, 2)), np.ones((height, width, 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rest = np.broadcast_to(np.array([0.7, 0.5, 0.3, 1, roughness]), (height, width, 5))
    return np.concatenate([rest, normal], -1).astype(np.float32)


def material_of_two(size: int) -> np.ndarray:
    """Bumpy gloss on one half, smooth gloss of varying roughness and colour on the other."""
    rng = np.random.default_rng(3)
    normal = np.concatenate([0.25 * rng.standard_normal((size, size, 2)), np.ones((size, size, 1))], -1)
    normal[:, size // 2 :] = 0, 0, 1
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rest = np.broadcast_to(np.array([0.7, 0.5, 0.3, 1, 0.25]), (size, size, 5)).copy()
    rest[:, size // 2 :, :3] = rng.random((size, size - size // 2, 1))
    rest[:, size // 2 :, 4] = rng.uniform(0.2, 0.7, (size, size - size // 2))
    return np.concatenate([rest, normal], -1).astype(np.float32)
