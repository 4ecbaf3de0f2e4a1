"""Sets of light-view pairs. The sets rank methods differently, so both are always reported.

Adding slope variance to alpha^2 gets the peak of a lobe right, which `near-mirror` sees, and fattens GGX's tails,
which `hemisphere` sees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import UsageError

NEAR_MIRROR_SPREAD = 0.12
"""Standard deviation, in radians, of the light around the mirror direction of the view."""


@dataclass(frozen=True)
class LightViewPairs:
    """K light and view directions, (K, 3) float32 unit vectors in tangent space, above the horizon."""

    light: NDArray[np.float32]
    view: NDArray[np.float32]


def cosine_directions(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count, 3) unit vectors on the upper hemisphere with density cos(theta) / pi (Malley's method)."""
    radius, angle = np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    z = np.sqrt(1 - radius * radius)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)


def near_mirror_lights(rng: np.random.Generator, view: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K, 3) lights: the mirror direction of (K, 3) views plus a Gaussian, renormalised; redrawn below the horizon."""
    mirror = view * [-1, -1, 1]
    light = np.zeros_like(view)
    missing = np.arange(len(view))
    while len(missing):
        drawn = mirror[missing] + NEAR_MIRROR_SPREAD * rng.standard_normal((len(missing), 3))
        light[missing] = drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)
        missing = missing[light[missing, 2] <= 0]
    return light


def _hemisphere(rng: np.random.Generator, view: NDArray[np.float64]) -> NDArray[np.float64]:
    return cosine_directions(rng, len(view))


PAIR_SETS: Mapping[str, Callable[[np.random.Generator, NDArray[np.float64]], NDArray[np.float64]]] = {
    "near-mirror": near_mirror_lights,
    "hemisphere": _hemisphere,
}
"""Name of each pair set and how it draws lights for given views; views are cosine-distributed in all of them."""


def pair_set(name: str, seed: int, count: int = 64) -> LightViewPairs:
    """The pair set of that name: `count` pairs, fixed by the seed. UsageError for an unknown name."""
    if name not in PAIR_SETS:
        raise UsageError(f"unknown pair set {name!r}: expected one of {', '.join(PAIR_SETS)}")
    rng = np.random.default_rng([seed, list(PAIR_SETS).index(name)])
    view = cosine_directions(rng, count)
    light = PAIR_SETS[name](rng, view)
    return LightViewPairs(light.astype(np.float32), view.astype(np.float32))
