"""Pair sets for a source: pairs that find its lobes, weighted back to the law of the set.

Most of the energy under single lights is in few pairs: those that hit a narrow lobe, and those that graze. A thousand
pairs drawn by the law alone meet some of them by chance, and an SNR then hangs on the seed by decibels. So half of the
pairs follow the law, and the other half follow what texels of the source reflect of it:

1. A pool of many pairs is drawn, half by the law and half with half vectors around lobes, and weighted by the balance
   heuristic of multiple importance sampling (Veach and Guibas 1995). The lobes are those of texels, and of means over
   windows of texels, which is what stacks hold. Views around lobes are the more frequent the lower they are, because
   radiance near the mirror grows like 1 / cos.
2. The same texels and means are lit by every pair of the pool. A pair is kept with a probability that is the mean of
   two: one is proportional to its weight, as the law wants it, the other one to its weight times its energy
   (importance resampling, Talbot et al. 2005). What is kept weighs the more, the less likely it was. Energies count
   the more, the lower the light and the view are, because errors grow faster there than radiance.

The mean of weight * g over a set is an unbiased estimate of the mean of g by the law, for any g. Half of the pairs
follow the law, so no weight is far above 2. No candidate is looked at: a set hangs on the source alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mipbake.material import model_named
from mipbake.quality.metrics.pairs import (
    PAIR_SETS,
    PAIRS,
    LightViewPairs,
    WeightedPairs,
    grid_cells,
    in_blocks,
    pair_set,
)
from mipbake.quality.reference import lobes
from mipbake.shading import shade

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_POOL, _LEAST_POOL = 32, 4096  # pairs of the pool for each that is kept, and no fewer than
_LIT, _LOBES = 128, 32  # texels that are lit, and those of them whose lobes pairs are drawn around; as many means
_IN_A_WINDOW = 32  # texels that a mean is taken over
_TOGETHER = 256  # pairs that are lit at a time
_LOW = 0.05  # cosine of views below which their density levels off
# By which power of the product of both cosines errors grow faster than energies, and the least product.
_FASTER, _LOWEST = 0.25, 1e-6
_STREAM = 982451653  # keeps these random numbers apart from those of pair_set; a seed


def weighted_pair_set(name: str, seed: int, texels: Image, model: str, count: int = PAIRS) -> WeightedPairs:
    """The pair set of that name for a source: `count` weighted pairs, fixed by the seed and the texels.

    Every block of BLOCK pairs is spread over views like the whole.

    Args:
        texels: (H, W, C) stored channels of the source's level 0, of which some are drawn.
        model: their material model.

    Raises:
        UsageError: an unknown pair set or material model.
    """
    size = max(_LEAST_POOL, _POOL * count)
    law = pair_set(name, seed, size - size // 2)
    rng = np.random.default_rng([_STREAM, seed, list(PAIR_SETS).index(name)])
    single, means = _drawn(texels, rng)
    lobe = np.concatenate([_lobes(each[:_LOBES], model) for each in (single, means)])
    light, view, weights = _pool(name, law, lobe, size // 2, rng)
    low = np.maximum(light[:, 2].astype(np.float64) * view[:, 2], _LOWEST) ** -_FASTER
    energies = [weights * low * _mean_squares(model, each, light, view) for each in (single, means)]
    expected = np.mean([each / each.mean() for each in (weights, weights, *energies)], 0)
    # Systematic: in the order of views, one pair at equal steps of the sum.
    order = np.argsort(view[:, 2])
    total = np.cumsum(expected[order])
    steps = (rng.random() + np.arange(count)) / count * total[-1]
    kept = in_blocks(order[np.minimum(np.searchsorted(total, steps, side="right"), size - 1)])
    return WeightedPairs(light[kept], view[kept], weights[kept] * (total[-1] / size) / expected[kept])


def _drawn(texels: Image, rng: np.random.Generator) -> tuple[Image, Image]:
    """(_LIT, C) each: texels, and means over windows of all sizes, which stacks are near to."""
    height, width = texels.shape[:2]
    sizes = 2.0 ** (np.arange(_LIT) % max(height, width).bit_length() + 1)
    corners, inside = rng.random((_LIT, 1, 2)) * [height, width], rng.random((_LIT, _IN_A_WINDOW, 2))
    rows, columns = np.moveaxis((corners + inside * sizes[:, None, None]).astype(np.intp), -1, 0)
    read = texels[rows % height, columns % width].astype(np.float32)
    return np.ascontiguousarray(read[:, 0]), read.mean(1)


def _pool(
    name: str, law: LightViewPairs, lobe: Image, count: int, rng: np.random.Generator
) -> tuple[Image, Image, Array]:
    """Lights and views of pairs by the law and of `count` pairs around lobes (M, 4), and their weights."""
    cosine, angle = _LOW * (1 + 1 / _LOW) ** grid_cells(rng, count)[:, 0] - _LOW, 2 * math.pi * rng.random(count)
    sine = np.sqrt(1 - np.square(cosine))
    own = np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], -1).astype(np.float32)
    uniform = rng.permutation(grid_cells(rng, count)).astype(np.float32)
    half = lobes.half_vectors(lobe[rng.permutation(np.arange(count) % len(lobe))], *uniform.T[:, None])[0]
    light, view = np.concatenate([law.light, lobes.reflected(own, half)]), np.concatenate([law.view, own])

    by_law = lobes.near_mirror_density(light, view) if name == "near-mirror" else lobes.hemisphere_density(light)
    by_law = by_law.astype(np.float64) * view[:, 2] / math.pi
    of_views = 1 / ((view[:, 2] + np.float64(_LOW)) * (2 * math.pi * math.log(1 + 1 / _LOW)))
    by_lobes = of_views * lobes.mixed_density(lobe, light, view)
    mixed = (len(law.light) * by_law + count * by_lobes) / len(light)
    above = light[:, 2] > 0
    light = np.where(above[:, None], light, np.array([0, 0, 1], np.float32))  # weighs nothing
    return light, view, np.where(above, by_law / np.maximum(mixed, 1e-30), 0)


def _lobes(texels: Image, model: str) -> Image:
    """(M, 4) lobes of (M, C) texels, as wide as the wider axis where they are stretched."""
    described = model_named(model)
    tensor = described.roughness_tensor(texels)
    alpha2 = tensor[:, 0]
    if tensor.shape[-1] > 1:
        alpha2 = (tensor[:, 0] + tensor[:, 1]) / 2 + np.hypot((tensor[:, 0] - tensor[:, 1]) / 2, tensor[:, 2])
    alpha = np.clip(lobes.WIDER * np.sqrt(alpha2), lobes.LEAST_ALPHA, 1)
    return np.concatenate([described.unit_normals(texels), alpha[:, None]], -1).astype(np.float32)


def _mean_squares(model: str, texels: Image, light: Image, view: Image) -> Array:
    """(K,) mean squared radiance of texels (N, C) under each of K pairs."""
    out = np.empty(len(light))
    for start in range(0, len(light), _TOGETHER):
        some = slice(start, start + _TOGETHER)
        radiance = shade(model, texels, light[some], view[some]).reshape(len(light[some]), -1)
        out[some] = np.einsum("kx,kx->k", radiance, radiance) / radiance.shape[1]
    return out
