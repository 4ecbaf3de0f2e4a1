"""Directions around lobes: half vectors distributed like GGX, and the densities of light-view pairs.

A lobe is four numbers: a unit normal that looks up, and alpha. All arrays here are float32, and so are the results.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.pairs import NEAR_MIRROR_SPREAD

Floats = NDArray[np.float32]
Reals = NDArray[Any]

WIDER, LEAST_ALPHA = 1.2, 0.004
"""Lobes that pairs are drawn from are a little wider, so that tails are seen and densities stay finite."""

_MIRRORED = np.array([-1, -1, 1], np.float32)

_AT_ONCE = 512  # pairs of a mixture that are worked on together, so that what lies between stays in the cache


def unit(vectors: Floats) -> Floats:
    """(..., 3) divided by their lengths."""
    return np.asarray(vectors / np.sqrt(np.maximum(_dot(vectors, vectors), 1e-20))[..., None])


def half_vectors(lobe: Floats, u: Floats, v: Floats) -> Floats:
    """(K, P, 3) half vectors distributed like the GGX lobes (P, 4), of uniform numbers (K, P)."""
    normal, alpha = lobe[:, :3], lobe[:, 3]
    slope = alpha * np.sqrt(u / np.maximum(1 - u, 1e-6))
    height = 1 / np.sqrt(1 + np.square(slope))
    angle = v * (2 * math.pi)
    # Frame of Duff et al. 2017 around a normal that looks up.
    a = -1 / (1 + np.maximum(normal[:, 2], -0.99))
    b = normal[:, 0] * normal[:, 1] * a
    tangent = np.stack([1 + np.square(normal[:, 0]) * a, b, -normal[:, 0]], -1)
    bitangent = np.stack([b, 1 + np.square(normal[:, 1]) * a, -normal[:, 1]], -1)
    along = slope * height
    x, y = along * np.cos(angle), along * np.sin(angle)
    return np.asarray(x[..., None] * tangent + y[..., None] * bitangent + height[..., None] * normal)


def reflected(view: Floats, half: Floats) -> Floats:
    """(..., 3) lights that half vectors reflect to views."""
    return unit((2 * _dot(view, half))[..., None] * half - view)


def lobe_density(lobe: Floats, light: Floats, view: Floats) -> Floats:
    """(K, P) density of (K, P, 3) lights whose half vectors with the views are distributed like the lobes (P, 4)."""
    half = unit(light + view)
    alpha2 = np.square(lobe[:, 3])
    signed = _dot(half, lobe[:, :3])
    across = half - lobe[:, :3] * signed[..., None]
    sine2 = _dot(across, across)  # 1 - cosine^2 would cancel
    cosine = np.abs(signed)  # a half vector and its opposite reflect alike
    distribution = alpha2 * cosine / (math.pi * np.square(alpha2 * np.square(cosine) + sine2))
    return np.asarray(distribution * 0.25 / np.maximum(np.abs(_dot(half, view)), 1e-4))


def mixed_density(lobe: Floats, light: Floats, view: Floats) -> NDArray[np.float64]:
    """(K,) density of (K, 3) lights drawn around any of the lobes (M, 4), each as often: the mean of `lobe_density`.

    In float64, where 1 - cosine^2 may cancel, so that all pairs meet all lobes in one product of matrices.
    """
    normal, alpha2 = lobe[:, :3].astype(np.float64), np.square(lobe[:, 3].astype(np.float64))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    out = np.empty(len(light))
    for start in range(0, len(light), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        seen = view[some].astype(np.float64)
        half = light[some] + seen
        half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-10)
        cosine = np.abs(half @ normal.T)  # a half vector and its opposite reflect alike
        wide = 1 - (1 - alpha2) * np.square(cosine)
        distribution = (alpha2 / math.pi * cosine / np.square(wide)).mean(1)
        out[some] = distribution * 0.25 / np.maximum(np.abs((half * seen).sum(-1)), 1e-4)
    return out


def around_mirror_density(light: Reals, view: Reals, spread: float = NEAR_MIRROR_SPREAD) -> Reals:
    """(...) density of (..., 3) unit vectors around the mirror direction of views, above the horizon or not.

    A Gaussian around a point of the unit sphere, projected onto it: its integral along the ray, to 1e-13 where it is
    not negligible.
    """
    s2 = spread**2
    square = np.square(np.maximum(_dot(light, view * _MIRRORED), 0))
    return np.asarray(np.exp((square - 1) / (2 * s2)) * (square + s2) / (2 * math.pi * s2))


def near_mirror_density(light: Floats, view: Floats) -> Floats:
    """(...) density of (..., 3) lights of the pair set `near-mirror`, given views that look up: lights below the
    horizon are drawn again."""
    around: Floats = around_mirror_density(light, view)
    return around / _normal_below(view[..., 2] / NEAR_MIRROR_SPREAD)


def hemisphere_density(light: Floats) -> Floats:
    """(...) density of (..., 3) lights of the pair set `hemisphere`."""
    return np.asarray(np.maximum(light[..., 2], 0) / math.pi)


def _dot(a: Reals, b: Reals) -> Reals:
    """(...) inner products of (..., 3) vectors, added axis by axis: sums along a last axis of three are slow."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _normal_below(x: Floats) -> Floats:
    """(...) how much of the standard normal distribution lies below numbers that are not negative.

    Within 1.2e-7, of which 7.5e-8 are the formula's (Abramowitz and Stegun 1964, 26.2.17); NumPy has no error function.
    """
    t = 1 / (1 + 0.2316419 * x)
    series = t * (0.319381530 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429))))
    return np.asarray(1 - np.exp(-0.5 * np.square(x)) * (series / math.sqrt(2 * math.pi)))
