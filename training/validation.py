"""Validation while training: SNR against the supersampled reference on patches the training never sees.

The same measure as `mipbake validate`, smaller: a fixed set of patches, each a torus, and few pairs and samples. The
references do not depend on the network and are made once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from mipbake import material
from mipbake.errors import OutputError
from mipbake.metrics import PAIR_SETS, LightViewPairs, pair_set, snr_db
from mipbake.models.network import Network
from mipbake.prefilter.linear import Linear
from mipbake.prefilter.pixel_filter import Wrap
from mipbake.render import candidate, random_points, reference
from mipbake.training.data import Materials

LODS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)
_PATCHES, _PATCH_SIZE, _PAIRS, _POINTS, _SAMPLES, _SEED = 8, 64, 16, 192, 64, 20230
_PICTURED, _PICTURE_LODS, _PICTURE_SAMPLES = 4, (0.0, 2.0), 64
_TORUS: Wrap = ("wrap", "wrap")
_SETS = tuple(PAIR_SETS)


@dataclass(frozen=True)
class Score:
    """Mean over patches of the SNR in dB, (pair sets, LODS), of the network and of what GPUs do (linear, box)."""

    network: NDArray[np.float64]
    linear: NDArray[np.float64]

    @property
    def total(self) -> float:
        """The network's mean over pair sets and levels of detail: what decides which checkpoint is the best."""
        return float(self.network.mean())

    def columns(self) -> dict[str, float]:
        """Named figures for the logs: each pair set's mean over LODS, for both methods."""
        methods = {"network": self.network, "linear": self.linear}
        return {f"{name} {s}": float(v[i].mean()) for name, v in methods.items() for i, s in enumerate(_SETS)}


@dataclass(frozen=True)
class _Case:
    lod: float
    uv: NDArray[np.float64]
    first: NDArray[np.float32]
    second: NDArray[np.float32]


class Validator:
    """Held-out patches with their references."""

    def __init__(self, materials: Materials, model: str, pixel_filter: str) -> None:
        rng = np.random.default_rng(_SEED)
        self.model, self.pixel_filter = model, pixel_filter
        sets = [pair_set(name, _SEED, _PAIRS) for name in _SETS]
        self.pairs = LightViewPairs(*(np.concatenate([getattr(p, a) for p in sets]) for a in ("light", "view")))
        self.patches = [
            material.regularise(patch, model) for patch in _central_patches(materials, _PATCHES, _PATCH_SIZE)
        ]
        self.cases = [[self._case(patch, lod, rng) for lod in LODS] for patch in self.patches]
        self.linear = np.mean(
            [
                self._snr(Linear()(patch, model, model, "box", _TORUS, lambda _: None).levels, cases)
                for patch, cases in zip(self.patches, self.cases, strict=True)
            ],
            0,
        )

    def _case(self, patch: NDArray[np.float32], lod: float, rng: np.random.Generator) -> _Case:
        uv = random_points(rng, _POINTS)
        first, second = (self._reference(patch, uv, lod, self.pairs, _SAMPLES, rng) for _ in range(2))
        return _Case(lod, uv, first, second)

    def _reference(
        self,
        patch: NDArray[np.float32],
        uv: NDArray[np.float64],
        lod: float,
        pairs: LightViewPairs,
        samples: int,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        return reference(patch, self.model, _TORUS, uv, lod, self.pixel_filter, pairs, samples, rng)

    def _snr(self, levels: list[NDArray[np.float32]], cases: list[_Case]) -> NDArray[np.float64]:
        figures = np.empty((len(_SETS), len(cases)))
        for column, case in enumerate(cases):
            shaded = candidate(levels, self.model, _TORUS, case.uv, case.lod, self.pairs)
            for row in range(len(_SETS)):
                part = slice(row * _PAIRS, (row + 1) * _PAIRS)
                figures[row, column] = snr_db(shaded[part], case.first[part], case.second[part])
        return figures

    def levels(self, network: Network, patch: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """The network's stack of one patch."""
        with torch.inference_mode():
            return [level[0].numpy() for level in network(torch.from_numpy(patch)[None], _TORUS)]

    def score(self, network: Network) -> Score:
        """Measures the network on every patch."""
        figures = [
            self._snr(self.levels(network, patch), cases) for patch, cases in zip(self.patches, self.cases, strict=True)
        ]
        return Score(np.mean(figures, 0), self.linear)

    def picture(self, network: Network, path: Path) -> None:
        """Writes a PNG: for some patches a row of prediction, target and error (times 4), near and far."""
        pairs = pair_set("near-mirror", _SEED, 1)
        centre = (np.arange(_PATCH_SIZE) + 0.5) / _PATCH_SIZE
        uv = np.stack(np.meshgrid(centre, centre), -1).reshape(-1, 2)
        rows = []
        for patch in self.patches[:_PICTURED]:
            levels, row = self.levels(network, patch), []
            for lod in _PICTURE_LODS:
                rng = np.random.default_rng(_SEED)
                target = self._reference(patch, uv, lod, pairs, _PICTURE_SAMPLES, rng)
                prediction = candidate(levels, self.model, _TORUS, uv, lod, pairs)
                exposure = 0.25 / max(float(target.mean()), 1e-6)
                shown = _tonemap(prediction * exposure), _tonemap(target * exposure)
                row += [*shown, np.clip(4 * abs(shown[0] - shown[1]), 0, 1)]
            rows.append(np.concatenate([r.reshape(_PATCH_SIZE, _PATCH_SIZE, 3) for r in row], 1))
        _write_png(path, np.concatenate(rows))


def _central_patches(materials: Materials, count: int, size: int) -> list[NDArray[np.float32]]:
    patches = []
    for index in range(count):
        image = materials.images[index % len(materials.images)]
        top, left = ((n - size) // 2 for n in image.shape[:2])
        patches.append(image[top : top + size, left : left + size].astype(np.float32))
    return patches


def _tonemap(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    shown: NDArray[np.float32] = np.power(radiance / (1 + radiance), 1 / 2.2, dtype=np.float32)
    return shown


def _write_png(path: Path, image: NDArray[np.float32]) -> None:
    import OpenImageIO

    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(image, np.float32))
    if not buffer.write(str(path), OpenImageIO.UINT8):
        raise OutputError(f"{path}: the validation picture cannot be written ({buffer.geterror()})")
