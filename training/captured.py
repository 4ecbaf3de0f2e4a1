"""Generated materials in the channels of generalised Beckmann lobes, of the kinds that captures of real surfaces show.

The paper trains its Beckmann networks on the materials of Aittala et al. 2015, "Two-shot SVBRDF capture for stationary
materials". Sets of glTF cannot stand in for all of them: converted, their lobes are round, and all have much the same
exponent. Here the tensor and the exponent are drawn directly: lobes that are wide across a thread or a scratch, sharp
peaks in a wide haze (an exponent far below 1), and peaks that end abruptly (above 1). Every material is stationary: its
parameter maps are fields with the same statistics everywhere. They depend on each other as they do in captures: where a
surface is glossier, its tails are heavier and its specular albedo is higher.

All numbers are guesses, after the materials that the captures show: leather, fabrics, metals, paints, plastics, paper,
stone. No metal is nearly a mirror, and the tails of metals are heavy: the paper says that its data has no extremely
sharp lobes, and metals that are black beside their highlights drown everything else in noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.material import MAX_LOG_GAMMA, model_named
from mipbake.training.reliefs import (
    Field,
    Relief,
    brushed,
    bumps,
    cells,
    noise,
    normals,
    rock,
    scratched,
    smooth,
    standardise,
    tiles,
    weave,
)

MODEL = "beckmann"
"""The material model of the sets that are made here."""

Range = tuple[float, float]

_DOMAIN = 0x74776F73  # a seed
_LEAST = math.log(model_named(MODEL).least_alpha2) / 2 + 0.01  # ln alpha; a little above what shading raises to
_ROUGHEST = 0.0  # ln alpha
_DIRECTED = 0.3  # difference of slope variances along two axes, over their sum, from which on bumps have a direction


@dataclass(frozen=True)
class Substance:
    """A kind of captured material, and what its sets are drawn from.

    Args:
        reliefs: what its height fields are.
        metal: share of its sets whose specular albedo is a metal's.
        alpha: roughness, the geometric mean of both axes of the tensor.
        stretch: ln of the ratio between the axes of the tensor.
        gamma: exponent of the lobes.
        slope: root mean square of the slopes of its height field.
        crossed: whether lobes are wide across the threads of a weave, whichever way the thread on top runs. Otherwise
            they are wide in one direction: across brush marks where there are any, else in a random one.
    """

    reliefs: tuple[Relief, ...]
    metal: float
    alpha: Range
    stretch: Range
    gamma: Range
    slope: Range
    crossed: bool = False


SUBSTANCES: dict[str, Substance] = {
    "leather": Substance((cells, bumps), 0.0, (0.1, 0.4), (0.0, 0.4), (0.35, 1.0), (0.05, 0.35)),
    "fabric": Substance((weave,), 0.05, (0.12, 0.6), (0.3, 1.3), (0.3, 0.9), (0.08, 0.5), crossed=True),
    "brushed metal": Substance((brushed, scratched), 1.0, (0.08, 0.3), (0.6, 1.6), (0.28, 0.8), (0.01, 0.12)),
    "cast metal": Substance((cells, rock, bumps), 1.0, (0.08, 0.4), (0.0, 0.5), (0.28, 0.8), (0.03, 0.3)),
    "paint": Substance((smooth, bumps), 0.3, (0.02, 0.15), (0.0, 0.2), (0.28, 0.9), (0.005, 0.06)),
    "plastic": Substance((bumps, cells, smooth), 0.0, (0.05, 0.35), (0.0, 0.3), (0.5, 1.8), (0.01, 0.25)),
    "paper": Substance((rock, bumps), 0.0, (0.2, 0.7), (0.0, 0.4), (0.5, 1.6), (0.02, 0.15)),
    "stone": Substance((rock, tiles, smooth), 0.0, (0.04, 0.5), (0.0, 0.3), (0.3, 1.6), (0.02, 0.3)),
}
"""Kinds of captured materials."""


def captured_set(seed: int, size: int) -> NDArray[np.float32]:
    """(size, size, 12) stored channels of the set with that seed, in MODEL; the same on every machine up to rounding.

    The kinds take turns.
    """
    kinds = list(SUBSTANCES.values())
    return captured(kinds[seed % len(kinds)], np.random.default_rng([seed, _DOMAIN]), size)


def captured(kind: Substance, rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    """A set of a kind."""
    height, region = kind.reliefs[int(rng.integers(len(kind.reliefs)))](rng, size)
    height = standardise(height) + rng.uniform(0, 0.3) * noise(rng, size, rng.uniform(0.15, 0.45))
    wear = noise(rng, size, math.exp(rng.uniform(math.log(0.01), math.log(0.3))))
    normal = normals(height, _between(rng, kind.slope))

    # Roughness varies with what the height and the wear are, and from one region to the other.
    varied = rng.uniform(-0.3, 0.3) * standardise(height) + rng.uniform(-0.35, 0.35) * wear
    varied += rng.normal(0, 0.4) * region + rng.uniform(0, 0.15) * noise(rng, size, 0.4)
    varied = np.clip(varied, -1.2, 1.2)
    log_alpha = math.log(_between(rng, kind.alpha)) + varied
    log_gamma = math.log(_between(rng, kind.gamma)) + rng.uniform(-0.1, 0.7) * varied
    log_gamma += rng.normal(0, 0.2) * region + rng.uniform(0, 0.1) * wear
    albedo, specular = _colours(kind, rng, height, wear, region, varied)
    tensor = _tensor(kind, rng, log_alpha, region, normal)
    log_gamma = np.clip(log_gamma, -MAX_LOG_GAMMA, MAX_LOG_GAMMA)[..., None]
    return np.concatenate([albedo, specular, normal[..., :2], tensor, log_gamma], -1).astype(np.float32)


def _between(rng: np.random.Generator, ends: Range) -> float:
    """Evenly distributed in the logarithm."""
    low, high = ends
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _colours(
    kind: Substance, rng: np.random.Generator, height: Field, wear: Field, region: Field, varied: Field
) -> tuple[Field, Field]:
    """Diffuse and specular albedo, (size, size, 3) each: darker in recesses, more specular where it is glossier."""
    metal = rng.random() < kind.metal
    tints = 1 - rng.uniform(0, 0.7) * rng.random((2, 3))
    # What captures find of a metal is not without a diffuse part: dust, oxide, light between grooves.
    diffuse = tints * (rng.uniform(0.02, 0.15, (2, 1)) if metal else rng.beta(1.2, 2.0, (2, 1)))
    shade = rng.uniform(0, 0.25) * standardise(height) + rng.uniform(-0.2, 0.2) * wear
    albedo = (diffuse[0] + (diffuse[1] - diffuse[0]) * region[..., None]) * np.exp(np.clip(shade, -1, 1))[..., None]
    if metal:
        base = (1 - rng.uniform(0, 0.5) * rng.random(3)) * rng.uniform(0.4, 0.95)
    else:
        # Of dyed fibres and of pearly paints it is tinted.
        base = rng.uniform(0.02, 0.09) * (1 - rng.uniform(0, 0.4) * rng.random(3))
    specular = base * np.exp(np.clip(-rng.uniform(0, 0.6) * varied, -1, 1))[..., None]
    return np.clip(albedo, 0, 1), np.clip(specular, 0, 1)


def _tensor(kind: Substance, rng: np.random.Generator, log_alpha: Field, region: Field, normal: Field) -> Field:
    """(size, size, 3) a, b, c of the logarithm of the roughness tensor."""
    size = len(log_alpha)
    axis = _wide_axis(kind, rng, normal) + rng.uniform(0, 0.2) * noise(rng, size, rng.uniform(0.02, 0.3))
    # The half of ln(alpha_along / alpha_across), negative where the axes have traded places.
    half = rng.uniform(*kind.stretch) / 2 * np.exp(rng.uniform(0, 0.3) * noise(rng, size, rng.uniform(0.02, 0.3)))
    signed = half * (2 * region - 1) if kind.crossed else half
    high, low = (np.clip(log_alpha + sign * signed, _LEAST, _ROUGHEST) for sign in (1, -1))
    mean, deviation = high + low, high - low  # of ln alpha^2
    along, across = np.cos(2 * axis), np.sin(2 * axis)
    return np.stack([mean + deviation * along, mean - deviation * along, deviation * across], -1)


def _wide_axis(kind: Substance, rng: np.random.Generator, normal: Field) -> float:
    """Angle of the direction that lobes are wide in: across what is brushed, where the slopes have a direction."""
    turned = float(rng.uniform(0, math.pi))
    if kind.crossed:
        return 0.0  # across the threads that run up and down
    x, y = normal[..., 0], normal[..., 1]
    difference, product = float(np.mean(x * x - y * y)), 2 * float(np.mean(x * y))
    directed = math.hypot(difference, product) > _DIRECTED * float(np.mean(x * x + y * y))
    return math.atan2(product, difference) / 2 if directed else turned
