"""Baked levels against linear ones in three.js: SNR and FLIP against three.js itself, supersampled.

    python benchmarks/engines/three_proof.py SETS --count 5 --results build/three.json

SETS is a folder of texture sets: the first ones by name that have a normal and a roughness map are measured. What has
been measured already stands in the results file and is not measured again. README.md has the tables.
"""

from __future__ import annotations

import functools
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from engine_sets import first_sets
from engine_textures import engine_maps, stack_maps
from engine_views import EngineView, engine_views
from numpy.typing import NDArray
from scipy.stats import qmc
from three_levels import check_levels
from three_page import ThreePage, opened_three
from three_table import Cell, arguments, keep

import mipbake
from mipbake import TextureSet
from mipbake.baking.adjust import Adjustments, adjusted
from mipbake.material.pixel_filter import filter_named
from mipbake.quality.metrics import ldr_flip, snr_db
from mipbake.quality.metrics.images import displayed

SIDE = 96
"""Pixels a side of every picture."""

TEXELS = 512
"""Texels a side of what is baked: the middle of a set, repeated like the set itself."""

CANDIDATES: Mapping[str, tuple[str, str, Adjustments]] = {
    "linear": ("linear", "box", Adjustments()),
    "linear, filtered": ("linear", "gaussian", Adjustments()),
    "neural": ("neural", "gaussian", Adjustments()),
    "auto": ("auto", "gaussian", Adjustments()),
    "neural, level 0 kept": ("neural", "gaussian", Adjustments(keep_level0=True)),
    "auto, level 0 kept": ("auto", "gaussian", Adjustments(keep_level0=True)),
}
"""Name to method, pixel filter, and what is changed after the bake. `linear` with a box is what an engine makes from
level 0.
"""

CONTAINERS: Mapping[str, tuple[str, ...]] = {
    "linear": ("ktx2-rgba8", "half", "ktx2-bc7", "ktx2-uastc"),
    "linear, filtered": ("ktx2-rgba8",),
    "neural": ("ktx2-rgba8", "half", "ktx2-bc7", "ktx2-uastc"),
    "auto": ("ktx2-rgba8",),
    "neural, level 0 kept": ("ktx2-rgba8",),
    "auto, level 0 kept": ("ktx2-rgba8",),
}
"""How each candidate reaches three.js."""

FIRST, MOST = 128, 1024
"""Samples a pixel in each half of the reference: at first, and at most."""

MARGIN_DB = 15.0
"""dB by which the reference's own noise shall lie below the error of the best candidate."""

PIXEL_FILTER = "gaussian"

Image = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reference:
    """Two independent estimates, (SIDE, SIDE, 3) linear radiance, and the pixels that the surface fills."""

    first: Image
    second: Image
    covered: NDArray[np.bool_]
    samples: int

    @property
    def mean(self) -> Image:
        return (self.first + self.second) / 2

    @property
    def snr(self) -> float:
        """SNR of the mean of both halves against the truth, from their difference, in dB."""
        a, b = self.first[self.covered], self.second[self.covered]
        return float(10 * np.log10((a * b).sum() / max(np.square(a - b).sum() / 4, 1e-300)))


def main() -> None:
    """Measures what is missing."""
    options = arguments(__doc__, "sets", count=5, results=None)
    cells: list[Cell] = []
    if options.results and options.results.exists():
        cells = json.loads(options.results.read_text())["cells"]
    with tempfile.TemporaryDirectory() as scratch, opened_three(Path(scratch)) as three:
        notes = {"engine": three.page.evaluate("() => proof.describe()"), "levels": check_levels(three)}
        print("\n".join(notes["levels"]), flush=True)
    for texture_set in first_sets(options.sets, options.count, TEXELS):
        done = {(c["view"], c["candidate"], c["container"]) for c in cells if c["set"] == texture_set.name}
        for found in measured(texture_set, done):
            cells += found
            keep({"notes": notes, "cells": cells}, options.results)


def measured(texture_set: TextureSet, done: set[tuple[str, str, str]]) -> Iterator[list[Cell]]:
    """The cells that are not done (view, candidate, container), a view at a time."""
    size = (texture_set.height, texture_set.width)
    keys = [(name, container) for name in CANDIDATES for container in CONTAINERS[name]]
    todo = {
        view: [key for key in keys if (view.name, *key) not in done]
        for view in engine_views(size, max(size).bit_length() - 1, SIDE)
    }
    if not any(todo.values()):
        return
    baked = functools.cache(lambda *asked: mipbake.bake(texture_set, asked[0], "gltf", asked[1]))
    wanted = {name for missing in todo.values() for name, _ in missing}
    stacks = {
        name: stack_maps(adjusted(baked(method, pixel_filter), texture_set, changes))
        for name, (method, pixel_filter, changes) in CANDIDATES.items()
        if name in wanted
    }
    with tempfile.TemporaryDirectory() as scratch, opened_three(Path(scratch)) as three:
        three.add_material("reference", engine_maps([texture_set.material("gltf")]), "float")
        for name, container in keys:
            if name in stacks:
                three.add_material(f"{name} {container}", stacks[name], container)
        for view, missing in todo.items():
            if missing:
                three.add_view(view.name, view.described())
                square = (SIDE, SIDE)
                shown = {key: three.rendered(view.name, " ".join(key), square)[..., :3] for key in missing}
                reference = _reference(three, view, shown.values())
                yield [_cell(texture_set.name, view, key, image, reference) for key, image in shown.items()]


def _reference(three: ThreePage, view: EngineView, candidates: Iterable[Image]) -> Reference:
    """Doubles the samples until the noise lies MARGIN_DB below the best candidate's error, or there are MOST."""
    samplers = [qmc.Sobol(2, seed=seed) for seed in (1, 2)]
    sums = [np.zeros((SIDE, SIDE, 4)) for _ in samplers]
    count, images = 0, list(candidates)
    kernel = filter_named(PIXEL_FILTER)
    while True:
        more = max(FIRST, count)
        for index, sampler in enumerate(samplers):
            offsets = kernel.offsets(sampler.random(more))[0]
            sums[index] += three.rendered(view.name, "reference", (SIDE, SIDE), offsets.reshape(-1).tolist())
        count += more
        covered = np.logical_and.reduce([each[..., 3] == count for each in sums])
        reference = Reference(sums[0][..., :3] / count, sums[1][..., :3] / count, covered, count)
        best = max(_snr(image, reference) for image in images)
        if reference.snr >= best + MARGIN_DB or count >= MOST:
            return reference


def _snr(image: Image, reference: Reference) -> float:
    covered = reference.covered
    return snr_db(image[covered], reference.first[covered], reference.second[covered])


def _cell(name: str, view: EngineView, key: tuple[str, str], image: Image, reference: Reference) -> Cell:
    # Edges of the surface do not concern textures: the background is the same in both.
    covered = reference.covered[..., None]
    pair = (displayed(np.where(covered, each, 0)) for each in (image, reference.mean))
    flip = ldr_flip(*pair).mean_over(reference.covered)
    return {
        **{"set": name, "view": view.name, "shape": view.shape, "scale": view.scale, "lod": view.lod},
        **{"candidate": key[0], "container": key[1], "snr": _snr(image, reference), "flip": flip},
        **{"samples": reference.samples, "reference_snr": reference.snr},
    }


if __name__ == "__main__":
    main()
