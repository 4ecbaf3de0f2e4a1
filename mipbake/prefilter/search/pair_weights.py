"""What a render weighs in the fit, so that decibels of sets of 64 pairs are what is gained.

The figure of a set of pairs is the logarithm of the sum of their errors e_k, and what counts is its mean over sets. Its
derivative by the error of one pair is phi(e_k) = E[1 / (e_k + the sum of 63 others)]: pairs that rule their set
(grazing views, highlights of mirrors) weigh less than the rest, by what they have more. Plain sums of squares follow
only these few pairs. They are half of it all the same: sets that hold such a pair are ruled by it, and the logarithm of
the expected energy, whose derivative is the same for all pairs, is gained as well.

phi comes from a set of common pairs that are rendered at some hundred pixels. Pairs of a pixel's own are not among
them; their errors are predicted, by a gamma regression with a logarithmic link on the common ones.

Closed forms differ in what they are good at, and nowhere may the fit be worse than the best of them: a level of detail
and pair set that is behind what is asked for gains weight until it is not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.judging.held_out import SET_SIZE, HeldOut
from mipbake.judging.weights import DESCENT
from mipbake.metrics.pairs import PAIR_SETS, LightViewPairs
from mipbake.prefilter.search.pixel_samples import Batch
from mipbake.reference.problem import Image
from mipbake.shading import shade

_SETS = 200  # random sets that phi is a mean over
_FLOOR = 1e-3  # share of the mean error: chance makes errors of single pairs vanish
_SOLVED = 1e-6  # error in units of the signal that is as good as none
_RIDGE, _ITERATIONS = 0.1, 20


class PairWeights:
    """Weights of renders for the state of a stack (`update`).

    Args:
        held_out: renders of the common pairs; levels of detail from `first` in steps of 1/2.
        material: (8,) stored channels of `gltf` that shade about as bright as the whole set.
        asked: (S, M) logarithms of the errors that are asked for at its levels of detail.
    """

    def __init__(self, held_out: HeldOut, material: NDArray[np.float32], asked: NDArray[np.float64]) -> None:
        self._held_out, self._asked = held_out, asked
        self._lods = np.array(held_out.lods)
        self._material = material
        self._urgency = np.ones_like(asked)
        rng = np.random.default_rng(0)
        size = min(SET_SIZE - 1, held_out.each)
        self._others = np.stack([rng.choice(held_out.each, size, replace=False) for _ in range(_SETS)])
        basis = self._basis(torch.from_numpy(self.pairs.light), torch.from_numpy(self.pairs.view))
        self._features = _features(basis).reshape(len(PAIR_SETS), held_out.each, -1)
        self._phi: dict[int, Tensor] = {}
        self._pooled: dict[tuple[int, int], float] = {}
        self._fits: dict[int, tuple[Tensor, Tensor]] = {}

    @property
    def pairs(self) -> LightViewPairs:
        """The common pairs, as many of each pair set, one set after the other."""
        return self._held_out.pairs

    def update(self, levels: Sequence[Image]) -> NDArray[np.float64]:
        """Takes the errors of a stack for those that count now; returns its (S, M) logarithms of errors."""
        typical = self._held_out.typical(levels)
        self._urgency = np.clip(
            self._urgency * np.exp(DESCENT.hurry * np.clip(typical - self._asked, -1, 1)), 1, DESCENT.most_urgent
        )
        for index, lod in enumerate(self._lods):
            if lod % 1:
                continue
            sums = self._held_out.sums(levels, index)
            phis, fits, others = [], [], []
            for kind, (signal, measured) in enumerate(zip(sums[..., 0], sums[..., 1], strict=True)):
                least = _FLOOR * max(0.0, measured.mean()) + _SOLVED * signal.mean() + 1e-12
                error = np.maximum(measured, least)
                rest = error[self._others].sum(1)
                self._pooled[int(lod), kind] = DESCENT.pooled / (SET_SIZE * float(error.mean()))
                phis.append((1 / (error[:, None] + rest)).mean(1) + self._pooled[int(lod), kind])
                fits.append(_gamma_regression(self._features[kind], error))
                others.append(1 / (1 / rest).mean())
            self._phi[int(lod)] = torch.from_numpy(np.concatenate(phis).astype(np.float32))
            self._fits[int(lod)] = (
                torch.from_numpy(np.stack(fits, 1).astype(np.float32)),
                torch.from_numpy(np.array(others, np.float32)),
            )
        return typical

    def of(self, batch: Batch) -> Tensor:
        """(K, P): what the squared error of each render counts in the mean over pixels."""
        urgency = torch.from_numpy(
            np.stack([np.interp(batch.lods, self._lods, each) for each in self._urgency]).astype(np.float32)
        )
        if batch.common is not None:
            part = len(batch.common) // len(urgency)
            return SET_SIZE / part * self._phi[batch.level][batch.common] * urgency.repeat_interleave(part, 0)
        assert batch.importance is not None
        fit, others = self._fits[batch.level]
        basis = self._basis(batch.light, batch.view)
        out = torch.zeros_like(basis[0])
        for kind in range(len(urgency)):
            error = _predicted(basis, fit[:, kind]) + others[kind]
            phi = 1 / error + self._pooled[batch.level, kind]
            out += batch.importance[kind] * (SET_SIZE * urgency[kind]) * phi
        return out

    def _basis(self, light: Tensor, view: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Logarithms of the mean material's radiance, of the cosines of view and light, and of 1 - h_z: (...) each."""
        # Shaped so that a texel, prepared once, sees many pairs.
        pairs = [d.reshape(1, *((-1, d.shape[-2]) if d.ndim > 2 else (1, -1)), 3).numpy() for d in (light, view)]
        texels = np.broadcast_to(self._material, (pairs[0].shape[2], 8))
        radiance = torch.from_numpy(shade("gltf", texels, *pairs)).mean(-1).reshape(light.shape[:-1])
        x, y, z = (light[..., axis] + view[..., axis] for axis in range(3))
        height = z * (x * x + y * y + z * z).clamp(min=1e-12).rsqrt()
        cosines = [d[..., 2].clamp(min=1e-3).log() for d in (view, light)]
        return radiance.clamp(min=1e-5).log(), cosines[0], cosines[1], (1 - height).clamp(min=1e-4).log()


def _features(basis: tuple[Tensor, Tensor, Tensor, Tensor]) -> NDArray[np.float64]:
    """(N, F) whose combinations predict logarithms of errors: the basis, and products of its angles."""
    radiance, a, b, c = (each.double().numpy() for each in basis)
    return np.stack([np.ones_like(a), radiance, a, b, c, a * a, b * b, c * c, a * b, a * c, b * c], -1)


def _predicted(basis: tuple[Tensor, Tensor, Tensor, Tensor], fit: Tensor) -> Tensor:
    """(...) exponentials of `_features` times (F,) coefficients."""
    radiance, a, b, c = basis
    one, r, a1, b1, c1, aa, bb, cc, ab, ac, bc = fit.tolist()
    by_a, by_b, by_c = a1 + aa * a + ab * b + ac * c, b1 + bb * b + bc * c, c1 + cc * c
    out: Tensor = (one + r * radiance + a * by_a + b * by_b + c * by_c).exp()
    return out


def _gamma_regression(features: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F,) coefficients so that values (N,) are about exp(features (N, F) @ coefficients), unbiased as ratios.

    Least squares of the logarithms to begin with, then Fisher scoring (McCullagh and Nelder 1989, section 8.3), damped.
    """
    information = features.T @ features + np.diag([1e-6] + [_RIDGE] * (features.shape[1] - 1))
    fit = np.linalg.solve(information, features.T @ np.log(values))
    fit[0] += np.log((values / np.exp(features @ fit)).mean())
    for _ in range(_ITERATIONS):
        ratio = values / np.exp(features @ fit)
        fit = fit + 0.5 * np.linalg.solve(information, features.T @ np.clip(ratio - 1, -1, 3))
    return np.asarray(fit)
