"""Pairs that stacks are judged by: groups like the sets of figures, and pairs where renders are bright.

The figure of 64 pairs hangs on how they fall. Means over sets see what most of them see; a stack that is better there
may be worse by decibels on a set with a view that grazes, since radiance near the mirror grows like 1 / cos and one
such pair outweighs all others, or with a pair that hits a narrow lobe. So renders of such pairs are measured by
themselves:

- near-mirror pairs whose views graze, though not so much that no stack shows anything right there. Nearly half of
  all sets hold one;
- the expected energy of all others near the mirror, for which lights closest to it are drawn more often than they come,
  and weigh less (Veach and Guibas 1995, the balance heuristic): flat gloss reflects such lights;
- the expected energy over the hemisphere, for which lights near the mirror and grazing views are drawn more often.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.pairs import NEAR_MIRROR_SPREAD, PAIR_SETS, LightViewPairs, cosine_directions
from mipbake.quality.reference.lobes import around_mirror_density

Array = NDArray[np.float64]

SET_SIZE = 64
"""Pairs of the sets that figures are quoted for (mipbake.quality.metrics.pairs.pair_set), and of a group. Not tuned:
figures are defined by it."""

KINDS = 2
"""Kinds of groups of bright pairs: near the mirror, views graze in the first kind, and do not in the second. Not tuned:
there are so many."""

_GRAZING = 0.03, 0.1  # cosines of views
_TIGHT = 0.03  # spread of the lights closest to the mirror direction


def draw_pairs(rng: np.random.Generator, each: int) -> LightViewPairs:
    """`each` random pairs drawn like every pair set in turn."""
    views = [cosine_directions(rng, each) for _ in PAIR_SETS]
    lights = [draw(rng, view) for draw, view in zip(PAIR_SETS.values(), views, strict=True)]
    return LightViewPairs(np.concatenate(lights).astype(np.float32), np.concatenate(views).astype(np.float32))


def draw_pool(rng: np.random.Generator, each: int, kind: int) -> tuple[LightViewPairs, Array]:
    """`each` pairs for every pair set in turn, and (S, each) weights in the means over them."""
    first, last = (_grazing if kind == 0 else _near_mirror)(rng, each), _hemisphere(rng, each)
    pairs = (np.concatenate(both).astype(np.float32) for both in zip(first[:2], last[:2], strict=True))
    by_name = {"near-mirror": first[2], "hemisphere": last[2]}
    return LightViewPairs(*pairs), np.stack([by_name[name] for name in PAIR_SETS]) / each


def _grazing(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Lights, views and weights: near-mirror pairs with grazing views."""
    low, high = _GRAZING
    view = _views(rng, np.sqrt(low**2 + _spread(rng, count) * (high**2 - low**2)))
    return PAIR_SETS["near-mirror"](rng, view), view, np.ones(count)


def _near_mirror(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Lights, views and weights: a mean of weight * g estimates the mean of g over near-mirror pairs with other
    views."""
    low = _GRAZING[1] ** 2
    view = _views(rng, np.sqrt(low + _spread(rng, count) * (1 - low)))
    light = PAIR_SETS["near-mirror"](rng, view)
    light[::2] = _around(rng, view[::2], _TIGHT)
    near, tight = (around_mirror_density(light, view, spread) for spread in (NEAR_MIRROR_SPREAD, _TIGHT))
    return light, view, 2 * near / np.maximum(near + tight, 1e-12) * (light[:, 2] > 0)


def _hemisphere(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """Lights, views and weights: a mean of weight * g estimates the mean of g over all pairs of that set whose views do
    not graze beyond the range."""
    height = (np.sqrt(1 + 8 * _spread(rng, count)) - 1) / 2  # density height + 1/2: cosine and uniform, in halves
    view, light = _views(rng, height), cosine_directions(rng, count)
    for kind, spread in enumerate((NEAR_MIRROR_SPREAD, _TIGHT)):
        some = slice(kind, None, 3)
        light[some] = _around(rng, view[some], spread)
    cosine = np.maximum(light[:, 2], 0) / np.pi
    densities = [around_mirror_density(light, view, spread) for spread in (NEAR_MIRROR_SPREAD, _TIGHT)] + [cosine]
    shares = [len(range(kind, count, len(densities))) / count for kind in range(len(densities))]
    mixed = np.einsum("d,dk->k", shares, densities)
    of_views = np.where(height > _GRAZING[0], 2 * height / (height + 0.5), 0)
    return light, view, of_views * cosine / np.maximum(mixed, 1e-12)


def _around(rng: np.random.Generator, view: Array, spread: float) -> Array:
    """(K, 3) lights around the mirror directions of views, above the horizon or not."""
    drawn = view * [-1, -1, 1] + spread * rng.standard_normal(view.shape)
    return np.asarray(drawn / np.linalg.norm(drawn, axis=-1, keepdims=True))


def _spread(rng: np.random.Generator, count: int) -> Array:
    """Uniform numbers, one in each of `count` equal parts of [0, 1), in random order."""
    return rng.permutation((np.arange(count) + rng.random(count)) / count)


def _views(rng: np.random.Generator, height: Array) -> Array:
    angle, flat = 2 * np.pi * _spread(rng, len(height)), np.sqrt(1 - height * height)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], -1)
