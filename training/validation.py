"""Validation while training: SNR against the supersampled reference on patches the training never sees.

It is the same measure as in `mipbake validate`, but smaller: a fixed set of patches, each a torus, and few pairs and
samples. The references do not depend on the network and are made once.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.lean import Lean
from mipbake.baking.rules.linear import Linear
from mipbake.base.publish import writing
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap
from mipbake.models.architecture import Architecture
from mipbake.models.base import Network
from mipbake.quality.metrics import PAIR_SETS, pair_set, snr_from_sums, snr_sums
from mipbake.quality.metrics.images import tonemapped
from mipbake.quality.metrics.pairs import WeightedPairs
from mipbake.quality.reference.estimate import reference
from mipbake.quality.reference.pair_sets import weighted_pair_set
from mipbake.quality.reference.sequences import random_points
from mipbake.quality.round_lookups import candidate
from mipbake.source.images.image_files import write_image
from mipbake.training.data import Materials

LODS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0)  # levels of detail
_SEED = 20230  # not tuned
_PICTURED, _PICTURE_LODS = 4, (0.0, 2.0)  # sets and levels of detail in pictures
_TORUS: Wrap = ("wrap", "wrap")
_SETS = tuple(PAIR_SETS)

BASELINES: Mapping[str, ClosedForm] = {form.name: form for form in (Linear(), Lean())}
"""What a network is compared with, each with the box that it comes from: what GPUs do, and LEAN mapping."""

Figures = dict[str, dict[str, list[float]]]
"""Model that is made to method to mean SNR in dB, of each pair set in order. Methods are `network` and BASELINES."""


@dataclass(frozen=True)
class ValidationEffort:
    """How much a validation measures.

    Args:
        patches: held-out patches. patch_size: their side in texels, a power of two; less where a set is smaller.
        pairs: light-view pairs of each pair set. points: pixels of each level of detail.
        samples: of a pixel of the reference. picture_samples: of a pixel of the pictured reference.
    """

    patches: int = 8
    patch_size: int = 64
    pairs: int = 16
    points: int = 192
    samples: int = 64
    picture_samples: int = 64


@dataclass(frozen=True)
class Score:
    """Mean over patches of the SNR in dB of the network and of BASELINES, in every model that the network makes.

    Args:
        models: that the network makes.
        network: (models, pair sets, LODS).
        baselines: name to the same of a closed form that makes the same models.
    """

    models: tuple[str, ...]
    network: NDArray[np.float64]
    baselines: Mapping[str, NDArray[np.float64]]

    @property
    def total(self) -> float:
        """The network's mean over models, pair sets and levels of detail: what decides which checkpoint is the best."""
        return float(self.network.mean())

    def columns(self) -> dict[str, float]:
        """Named figures for the logs: each pair set's mean over LODS, for every method, then the network's by model."""
        methods = {name: each.mean(0) for name, each in self._methods().items()}
        if len(self.models) > 1:
            methods |= dict(zip(self.models, self.network, strict=True))
        return {f"{name} {s}": float(v[i].mean()) for name, v in methods.items() for i, s in enumerate(_SETS)}

    def figures(self) -> Figures:
        """Means over LODS, for model cards."""
        return {
            model: {name: [float(each) for each in v[index].mean(-1)] for name, v in self._methods().items()}
            for index, model in enumerate(self.models)
        }

    def _methods(self) -> dict[str, NDArray[np.float64]]:
        return {"network": self.network, **self.baselines}


@dataclass(frozen=True)
class _Patch:
    """A held-out patch (H, W, C) in one of the models that the network reads, and its pairs of all pair sets."""

    model: str
    stored: NDArray[np.float32]
    pairs: WeightedPairs


@dataclass(frozen=True)
class _Case:
    lod: float
    uv: NDArray[np.float64]
    first: NDArray[np.float32]
    second: NDArray[np.float32]


class Validator:
    """Held-out patches with their references; models that the network reads take turns."""

    def __init__(
        self, materials: Materials, config: Architecture, pixel_filter: str, effort: ValidationEffort | None = None
    ) -> None:
        rng, self.effort = np.random.default_rng(_SEED), effort or ValidationEffort()
        self.models, self.pixel_filter = config.decoders, pixel_filter
        self.patches = [
            _patch(materials, index, source, index // len(config.encoders), self.effort)
            for index, source in zip(range(self.effort.patches), itertools.cycle(config.encoders), strict=False)
        ]
        self.cases = [[self._case(patch, lod, rng) for lod in LODS] for patch in self.patches]
        self.baselines = {name: self._mean(partial(self._averaged, form)) for name, form in BASELINES.items()}

    def _case(self, patch: _Patch, lod: float, rng: np.random.Generator) -> _Case:
        uv = random_points(rng, self.effort.points)
        source = FilteredSource(patch.stored, patch.model, _TORUS, self.pixel_filter)
        first, second = (reference(source, uv, lod, patch.pairs, self.effort.samples, rng) for _ in range(2))
        return _Case(lod, uv, first, second)

    def _snr(
        self, levels: list[NDArray[np.float32]], model: str, patch: _Patch, cases: list[_Case]
    ) -> NDArray[np.float64]:
        """(pair sets, LODS) of a stack of a patch."""
        figures = []
        for case in cases:
            shaded = candidate(levels, model, _TORUS, case.uv, case.lod, patch.pairs)
            sums = snr_sums(shaded, case.first, case.second) * patch.pairs.weights[:, None]
            figures.append(snr_from_sums(sums.reshape(len(_SETS), -1, sums.shape[-1]).sum(1)))
        return np.stack(figures, 1)

    def stacks(self, network: Network, patch: _Patch) -> dict[str, list[NDArray[np.float32]]]:
        """The network's stacks of one patch, by model."""
        with torch.inference_mode():
            stacks = network(torch.from_numpy(patch.stored)[None].to(network.device), patch.model, self.pixel_filter)
        return {model: [level[0].cpu().numpy() for level in levels] for model, levels in stacks.items()}

    def score(self, network: Network) -> Score:
        """Measures the network on every patch."""
        return Score(self.models, self._mean(partial(self.stacks, network)), self.baselines)

    def _mean(self, stacks: Callable[[_Patch], Mapping[str, list[NDArray[np.float32]]]]) -> NDArray[np.float64]:
        """(models, pair sets, LODS), the mean over patches, of what makes stacks of a patch."""
        figures = []
        for patch, cases in zip(self.patches, self.cases, strict=True):
            made = stacks(patch)
            figures.append([self._snr(made[model], model, patch, cases) for model in self.models])
        return np.asarray(np.mean(figures, 0))

    def _averaged(self, form: ClosedForm, patch: _Patch) -> dict[str, list[NDArray[np.float32]]]:
        """A closed form's stacks of one patch, by model."""
        return {
            model: form(patch.stored, patch.model, model, "box", _TORUS, lambda _: None).levels for model in self.models
        }

    def picture(self, network: Network, path: Path) -> None:
        """Writes a PNG: for some patches a row of prediction (first model), reference and 4 x error, near and far."""
        pairs, size = pair_set("near-mirror", _SEED, 1), self.effort.patch_size
        centre = (np.arange(size) + 0.5) / size
        uv = np.stack(np.meshgrid(centre, centre), -1).reshape(-1, 2)
        rows = []
        for patch in self.patches[:_PICTURED]:
            levels, row = self.stacks(network, patch)[self.models[0]], []
            for lod in _PICTURE_LODS:
                source = FilteredSource(patch.stored, patch.model, _TORUS, self.pixel_filter)
                rng = np.random.default_rng(_SEED)
                right = reference(source, uv, lod, pairs, self.effort.picture_samples, rng)
                prediction = candidate(levels, self.models[0], _TORUS, uv, lod, pairs)
                exposure = 0.25 / max(float(right.mean()), 1e-6)
                shown = _tonemap(prediction * exposure), _tonemap(right * exposure)
                row += [*shown, np.clip(4 * abs(shown[0] - shown[1]), 0, 1)]
            rows.append(np.concatenate([r.reshape(size, size, 3) for r in row], 1))
        _write_png(path, np.concatenate(rows))


def _patch(materials: Materials, index: int, source: str, turn: int, effort: ValidationEffort) -> _Patch:
    """The middle of set `index` in a model, as large as a power of two can be there; of a captured set every second
    turn, where that model reads such sets."""
    captured = materials.captured
    chosen = captured if captured is not None and captured.model == source and turn % 2 else materials
    image = chosen.images[index % len(chosen.images)]
    size = min(effort.patch_size, 1 << (min(image.shape[:2]).bit_length() - 1))
    top, left = ((n - size) // 2 for n in image.shape[:2])
    stored = image[top : top + size, left : left + size].astype(np.float32)
    stored = material.regularise(material.convert(stored, chosen.model, source), source)
    sets = [weighted_pair_set(name, _SEED, stored, source, effort.pairs) for name in _SETS]
    pairs = WeightedPairs(*(np.concatenate([getattr(p, a) for p in sets]) for a in ("light", "view", "weights")))
    return _Patch(source, stored, pairs)


def _tonemap(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Filters with negative lobes make negative radiance, which is black."""
    shown: NDArray[np.float32] = np.power(tonemapped(radiance), 1 / 2.2, dtype=np.float32)
    return shown


def _write_png(path: Path, image: NDArray[np.float32]) -> None:
    import OpenImageIO

    texels = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    height, width, channels = texels.shape
    with writing(f"cannot write the validation picture {path}"):
        write_image(path, [(OpenImageIO.ImageSpec(width, height, channels, "uint8"), texels)])
