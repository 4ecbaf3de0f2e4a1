"""Plain torch twins of stochastic gradients, written from the paper: slow, and for tests.

Deliot, Heitz and Belcour 2024, section 4; signs by `pcg3d` of Jarzynski and Olano 2020. Arguments are as in
`mipbake.stochastic`; results are new tensors.
"""

from __future__ import annotations

import torch
from torch import Tensor

_MASK = 0xFFFFFFFF


def signs(count: int, step: int, seed: int) -> Tensor:
    """(count,) float64: 1 or -1 of parameters 0 to count - 1."""
    x = torch.arange(count, dtype=torch.int64)
    y, z = torch.full_like(x, step), torch.full_like(x, seed)
    x, y, z = (_product(v, torch.full_like(v, 1664525)) + 1013904223 & _MASK for v in (x, y, z))
    x, y, z = _round(x, y, z)
    x, y, z = (v ^ (v >> 16) for v in (x, y, z))
    x = x + _product(y, z) & _MASK
    return torch.where(x >> 31 == 1, 1.0, -1.0).double()


def _product(a: Tensor, b: Tensor) -> Tensor:
    """a * b modulo 2^32 of numbers below 2^32, in 64 bits: by halves of b."""
    low, high = b & 0xFFFF, b >> 16
    return a * low + ((a * high & _MASK) << 16) & _MASK


def _round(x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    x = x + _product(y, z) & _MASK
    y = y + _product(z, x) & _MASK
    z = z + _product(x, y) & _MASK
    return x, y, z


def perturb(
    values: Tensor, magnitude: Tensor, low: Tensor, high: Tensor, step: int, seed: int
) -> tuple[Tensor, Tensor, Tensor]:
    """theta + s epsilon, theta - s epsilon, and s, of all (N, C) values, without lifted normals."""
    s = signs(values.numel(), step, seed).view_as(values).to(values)
    middle = torch.maximum(torch.minimum(values, high - magnitude), low + magnitude)
    middle = torch.where(high - low < 2 * magnitude, (low + high) / 2, middle)
    middle = torch.where(magnitude > 0, middle, values)
    return middle + s * magnitude, middle - s * magnitude, s


def gradient(differences: Tensor, touched: Tensor, s: Tensor, magnitude: Tensor) -> Tensor:
    """(N, C) of equation 8: `touched` (P, K) elements of each pixel, `s` (N, C) signs."""
    sums = torch.zeros(len(s), dtype=s.dtype)
    for pixel, elements in enumerate(touched.tolist()):
        for element in {e for e in elements if e >= 0}:
            sums[element] += differences[pixel]
    return torch.where(magnitude > 0, s * sums[:, None] / (2 * torch.where(magnitude > 0, magnitude, 1.0)), 0.0)


def differences(plus: Tensor, minus: Tensor, reference: Tensor) -> Tensor:
    """(P,) of images (P, C)."""
    return (plus - reference).square().sum(-1) - (minus - reference).square().sum(-1)
