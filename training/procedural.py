"""Procedural texture sets from seeds, so that anyone can train without downloading anything.

A set is a relief (what is bumpy), a wear field (where it is glossy or dull) and one or two substances. Every field is
periodic, and normals correlate with colour and roughness. `reliefs` has the kinds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.training.reliefs import RELIEFS, noise, normals, smooth, standardise

MODEL = "gltf"
"""The material model of the sets that are made here."""


def procedural_set(seed: int, size: int) -> NDArray[np.float32]:
    """(size, size, C) stored channels of the set with that seed, in MODEL; the same on every machine up to rounding."""
    rng = np.random.default_rng([seed, 0x6D697062])
    relief = RELIEFS[int(rng.integers(len(RELIEFS)))]
    height, region = relief(rng, size)
    if rng.random() < 0.5:  # fine grain on top
        height = height + rng.uniform(0.02, 0.4) * noise(rng, size, rng.uniform(0.15, 0.45))
    steepest = 0.02 if relief is smooth else 0.8
    normal = normals(height, steepest * np.exp(rng.uniform(np.log(0.025), 0)))
    wear = 0.7 * noise(rng, size, rng.uniform(0.01, 0.3)) + rng.uniform(-0.5, 0.5) * standardise(height)
    metals = rng.random(2) < 0.4
    colours = np.stack([_colour(rng, bool(metal)) for metal in metals])
    share = region[..., None]
    base = colours[0] + (colours[1] - colours[0]) * share
    base = np.clip(base * (1 + rng.uniform(0, 0.25) * wear[..., None]), 0.0, 1.0)
    metallic = metals[0] + (float(metals[1]) - metals[0]) * share
    dull = 0.12 + 0.8 * rng.beta(1.2, 1.5, 2)
    roughness = dull[0] + (dull[1] - dull[0]) * region + rng.uniform(0, 0.15) * np.clip(wear, -1.5, 3)
    maps = [base, metallic, np.clip(roughness, 0.08, 1)[..., None], normal]
    return np.concatenate(maps, -1).astype(np.float32)


def _colour(rng: np.random.Generator, metal: bool) -> NDArray[np.float64]:
    tint = 1 - rng.uniform(0, 0.6) * rng.random(3)
    return tint * (rng.uniform(0.5, 1.0) if metal else rng.beta(1.0, 2.5))
