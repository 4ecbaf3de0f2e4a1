"""What a render weighs in the fit, so that decibels of sets of 64 pairs are what is gained.

The figure of a set of pairs is the logarithm of the sum of their errors e_k, and what counts is its mean over sets. Its
derivative by the error of one pair is phi(e_k) = E[1 / (e_k + the sum of 63 others)]: pairs that rule their set
(grazing views, highlights of mirrors) weigh less than the rest, by what they have more. Plain sums of squares follow
only these few pairs. They count all the same: sets that hold such a pair are ruled by it, and the logarithm of
the expected energy, whose derivative is the same for all pairs, is gained as well.

phi comes from a set of common pairs that are rendered at some hundred pixels. Pairs of a pixel's own are not among
them; their errors are predicted, by a gamma regression with a logarithmic link on the common ones.

How much each level of detail and pair set counts is what the judge says: more while it is behind. Terms of bright
pairs count in the expected energy of all pairs of their pair set, and groups that are behind by themselves do not count
here: which pairs those are, pixels with few pairs cannot tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.search.pixel_samples import PLAIN, Chunk
from mipbake.quality.judging.judge import Judge
from mipbake.quality.judging.pairs import KINDS, SET_SIZE
from mipbake.quality.judging.probes import Probe
from mipbake.quality.judging.scores import Errors, Scores
from mipbake.quality.judging.shown import KINDS_SHOWN
from mipbake.quality.metrics.pairs import PAIR_SETS, LightViewPairs
from mipbake.quality.reference.problem import Image
from mipbake.shading import shade

_SETS = 200  # random sets that phi is a mean over
_FLOOR = 1e-3  # share of the mean error: chance makes errors of single pairs vanish
_SOLVED = 1e-6  # error in units of the signal that is as good as none
_RIDGE, _ITERATIONS = 0.1, 20  # of the regression, and its rounds


class PairWeights:
    """Weights of renders for the state of a stack (`update`).

    Args:
        scores: renders of the common pairs; levels of detail in steps of 1/2.
        judge: says what they count.
        material: (C,) stored channels of PLAIN that shade about as bright as the whole set.
    """

    def __init__(self, scores: Scores, judge: Judge, material: NDArray[np.float32]) -> None:
        self._judge, self._material = judge, material
        self._lods = np.array(scores.lods)
        self._common = {int(probe.lod): _Common(probe, self) for probe in scores.probes if probe.lod == int(probe.lod)}
        self._single: NDArray[np.float64] = np.zeros((2, len(PAIR_SETS), len(self._lods)))
        self._visible: NDArray[np.float64] = np.zeros((KINDS_SHOWN, len(self._lods)))

    def pairs(self, level: int) -> LightViewPairs:
        """The common pairs of a level, as many of each pair set, one set after the other."""
        return self._common[level].pairs

    def update(self, errors: Sequence[Errors]) -> None:
        """Takes the errors of a stack, one for every level of detail, for those that count now."""
        slopes = [self._judge.slopes(each.score, index) for index, each in enumerate(errors)]
        bright = np.stack([each.pooled for each in slopes], 1).reshape(KINDS, len(PAIR_SETS), -1).sum(0)
        # What nepers of typical errors of each pair set count, and nepers of its expected energy.
        self._single = np.stack([np.stack([each.log_errors for each in slopes], 1), bright])
        self._visible = np.stack([by.visible / each.visible.means for by, each in zip(slopes, errors, strict=True)], 1)
        for lod, each in zip(self._lods, errors, strict=True):
            if lod == int(lod):
                self._common[int(lod)].update(each.squares)

    def visible(self, level: int) -> NDArray[np.float64]:
        """(V,) what the visible error of each kind of pictures counts at a level."""
        return np.array([np.interp(level, self._lods, row) for row in self._visible])

    def of(self, chunk: Chunk) -> Image:
        """(K, P): what the squared error of each render, summed over colours, counts in the mean over pixels."""
        common, lods = self._common[chunk.level], chunk.lods
        slopes = [np.interp(lods, self._lods, each) for rows in self._single for each in rows]
        typical, pooled = np.stack(slopes).astype(np.float32).reshape(2, len(PAIR_SETS), -1)
        if chunk.common is not None:
            part = len(chunk.common) // len(typical)
            own, every = (np.repeat(each, part, 0) for each in (typical, pooled))
            weight = common.phi[chunk.common] * own + common.pooled[chunk.common] * every
            return np.asarray(weight * (SET_SIZE / part / 3))
        assert chunk.importance is not None
        basis = self.basis(chunk.light, chunk.view)
        out = np.zeros_like(basis[0])
        for kind, importance in enumerate(chunk.importance):
            phi = 1 / (_predicted(basis, common.fits[:, kind]) + common.others[kind])
            every = common.pooled[kind * (len(common.pooled) // len(PAIR_SETS))]
            out += importance * (SET_SIZE / 3) * (typical[kind] * phi + pooled[kind] * every)
        return out

    def basis(self, light: Image, view: Image) -> tuple[Image, Image, Image, Image]:
        """Logarithms of the mean material's radiance, of the cosines of view and light, and of 1 - h_z: (...) each."""
        # Shaped so that a texel, prepared once, sees many pairs.
        pairs = [d.reshape(1, *((-1, d.shape[-2]) if d.ndim > 2 else (1, -1)), 3) for d in (light, view)]
        texels = np.broadcast_to(self._material, (pairs[0].shape[2], PLAIN.channels))
        radiance = shade(PLAIN.name, texels, *pairs).mean(-1).reshape(light.shape[:-1])
        x, y, z = (light[..., axis] + view[..., axis] for axis in range(3))
        height = z / np.sqrt(np.maximum(x * x + y * y + z * z, 1e-12))
        cosines = [np.log(np.maximum(d[..., 2], 1e-3)) for d in (view, light)]
        return np.log(np.maximum(radiance, 1e-5)), cosines[0], cosines[1], np.log(np.maximum(1 - height, 1e-4))


class _Common:
    """The common pairs of a level, and what their errors say."""

    def __init__(self, probe: Probe, weights: PairWeights) -> None:
        self._groups = probe.groups
        light, view = (self._by_set(each).reshape(-1, 3) for each in (probe.light, probe.view))
        self.pairs = LightViewPairs(light, view)
        each = len(light) // len(PAIR_SETS)
        self._signal = self._by_set(probe.signal)
        rng = np.random.default_rng(0)
        self._others = np.stack([rng.choice(each, SET_SIZE - 1, replace=False) for _ in range(_SETS)])
        self._features = _features(weights.basis(light, view)).reshape(len(PAIR_SETS), each, -1)

    def _by_set(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """(S, K, ...) of the pairs of each pair set, of (G, S * 64, ...)."""
        own = values[: self._groups].reshape(self._groups, len(PAIR_SETS), SET_SIZE, *values.shape[2:])
        return np.ascontiguousarray(own.swapaxes(0, 1).reshape(len(PAIR_SETS), -1, *values.shape[2:]))

    def update(self, squares: NDArray[np.float64]) -> None:
        """Takes (G, S * 64) mean square errors of pairs."""
        phis, fits, others, pooled = [], [], [], []
        for signal, measured, features in zip(self._signal, self._by_set(squares), self._features, strict=True):
            least = _FLOOR * max(0.0, measured.mean()) + _SOLVED * signal.mean() + 1e-12
            error = np.maximum(measured, least)
            rest = error[self._others].sum(1)
            pooled.append(np.full(len(error), 1 / (SET_SIZE * error.mean())))
            phis.append((1 / (error[:, None] + rest)).mean(1))
            fits.append(_gamma_regression(features, error))
            others.append(1 / (1 / rest).mean())
        rows = (np.concatenate(phis), np.concatenate(pooled), np.stack(fits, 1), np.array(others))
        self.phi, self.pooled, self.fits, self.others = (row.astype(np.float32) for row in rows)


def _features(basis: tuple[Image, Image, Image, Image]) -> NDArray[np.float64]:
    """(N, F) whose combinations predict logarithms of errors: the basis, and products of its angles."""
    radiance, a, b, c = (each.astype(np.float64) for each in basis)
    return np.stack([np.ones_like(a), radiance, a, b, c, a * a, b * b, c * c, a * b, a * c, b * c], -1)


def _predicted(basis: tuple[Image, Image, Image, Image], fit: Image) -> Image:
    """(...) exponentials of `_features` times (F,) coefficients."""
    radiance, a, b, c = basis
    one, r, a1, b1, c1, aa, bb, cc, ab, ac, bc = fit.tolist()
    by_a, by_b, by_c = a1 + aa * a + ab * b + ac * c, b1 + bb * b + bc * c, c1 + cc * c
    with np.errstate(over="ignore"):  # far from the common pairs, an error may seem infinite: its pair weighs nothing
        return np.asarray(np.exp(one + r * radiance + a * by_a + b * by_b + c * by_c))


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
