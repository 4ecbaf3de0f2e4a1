"""Materials in diffuse and specular colours as base colour and metallic: the nearest, and how near that is.

KHR_materials_pbrSpecularGlossiness (Khronos, archived) defines a material by a diffuse colour, a specular colour s (its
reflectance at normal incidence, F0) and a glossiness g: its diffuse albedo is diffuse (1 - max(s)), and alpha is
(1 - g)^2. glTF 2.0 (appendix B) defines one by a base colour b, a metallic m and a roughness r: the diffuse albedo is
0.96 (1 - m) b, F0 is 0.04 (1 - m) + m b, and alpha is r^2. So r = 1 - g exactly, and a texel wants, in each of three
channels, with d = diffuse (1 - max(s)) / 0.96,

    (1 - m) b = d  and  0.04 (1 - m) + m b = s.

These are six equations for four unknowns, each in 0 to 1: here they are solved by least squares. For a given m the best
b is a projection, so that one number is searched for. Khronos's converter between the two models solves the same
equations for m by the perceived brightness of both colours instead, which is the same where they are grey.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.material import DIELECTRIC_F0

Pixels = NDArray[np.float32]

RANGES = (0.01, 0.03, 0.1)
"""Differences of diffuse albedo or F0, of 1, that a report counts texels from. Below the first nobody sees any."""

_ROWS = 1 << 17  # texels that are solved at once, so that they stay in the cache
# Metallics that are tried: first these, then around the best of them.
_GRID = np.linspace(0.0, 1.0, 17)
_AROUND, _NARROWINGS = np.linspace(-1.0, 1.0, 9), 4  # each finds the minimum to a quarter of the step before
_PREFERENCE = 1e-5
"""What a whole metallic costs, beside a sum of six squares: dark materials have two solutions, and rounding to 8 bits
must not lead from one texel's to the other's."""


@dataclass(frozen=True)
class Loss:
    """What metallic-roughness does not hold of a material.

    Args:
        texels: all of them.
        counts: for each of `RANGES` those whose diffuse albedo or F0 differ, in any channel, from there to the next.
        most: the greatest difference.
    """

    texels: int
    counts: tuple[int, ...]
    most: float

    @property
    def lossless(self) -> bool:
        """Whether no texel differs by what can be seen."""
        return not any(self.counts)

    def __str__(self) -> str:
        """The loss as the end of a sentence."""
        ends = [f" to {end:g}" for end in RANGES[1:]] + [" or more"]
        parts = [f"{n} by {low:g}{end}" for n, low, end in zip(self.counts, RANGES, ends, strict=True) if n]
        return (
            f"{sum(self.counts)} of {self.texels} texels have a diffuse albedo or F0 that metallic-roughness cannot "
            f"represent, and are off by up to {self.most:.2f} of 1: {', '.join(parts)}"
        )


def metallic_roughness(diffuse: Pixels, specular: Pixels) -> tuple[Pixels, Pixels, Loss]:
    """Base colour (H, W, 3) and metallic (H, W, 1) of linear colours (H, W, 3) in [0, 1], and what is lost."""
    height, width = diffuse.shape[:2]
    base, metallic = np.empty((height * width, 3), np.float32), np.empty((height * width, 1), np.float32)
    off = np.empty(height * width, np.float32)
    given = diffuse.reshape(-1, 3), specular.reshape(-1, 3)
    for start in range(0, height * width, _ROWS):
        part = slice(start, start + _ROWS)
        base[part], metallic[part], off[part] = _solved(*(each[part].astype(np.float64) for each in given))
    counts = [int(np.count_nonzero(off >= low)) for low in RANGES]
    apart = tuple(n - more for n, more in zip(counts, [*counts[1:], 0], strict=True))
    return (
        base.reshape(height, width, 3),
        metallic.reshape(height, width, 1),
        Loss(height * width, apart, float(off.max())),
    )


def _solved(
    diffuse: NDArray[np.float64], specular: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Base colours (N, 3), metallic (N, 1) and the greatest difference (N,) of texels."""
    s, e = specular, DIELECTRIC_F0
    d = diffuse * (1 - s.max(-1, keepdims=True)) / (1 - e)
    sums = [(x * y).sum(-1) for x, y in ((d, d), (s, s), (d, s))] + [d.sum(-1), s.sum(-1)]
    m, least = np.zeros(len(d)), np.full(len(d), np.inf)
    middle, offsets = m, _GRID
    for _ in range(1 + _NARROWINGS):
        for offset in offsets:
            tried = np.clip(middle + offset, 0, 1)
            cost = _misfit(tried, sums) + _PREFERENCE * tried
            better = cost < least
            least, m = np.where(better, cost, least), np.where(better, tried, m)
        middle, offsets = m, (offsets[1] - offsets[0]) * _AROUND
    m = m[:, None]
    q = 1 - m
    base = np.clip((d * q + (s - e * q) * m) / (q * q + m * m), 0, 1)
    off = np.maximum(np.abs(q * base - d) * (1 - e), np.abs(e * q + m * base - s)).max(-1)
    return base, m, off


def _misfit(m: NDArray[np.float64], sums: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Sum over the channels of the squared distance of (d, s - 0.04 (1 - m)) from the line of ((1 - m) b, m b)."""
    dd, ss, ds, d, s = sums
    q, e = 1 - m, DIELECTRIC_F0
    across = m * m * dd + q * q * ss + 3 * e * e * q**4 - 2 * m * q * ds + 2 * e * m * q * q * d - 2 * e * q**3 * s
    return np.asarray(across / (q * q + m * m))
