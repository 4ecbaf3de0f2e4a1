"""What `--aim` moves, and how far the limit is: SNR under single lights, and visible error, of small parts of sets.

    python docs/remake.py --measure aims --materials MATERIALS   measures, and makes the section of docs/results.md
    python benchmarks/aims.py MATERIALS --results FILE           measures, and writes the file

MATERIALS is a folder of texture sets. The middle of some of them is baked by `auto` with several aims, by the network
and by closed forms. Beside them stand two limits of one lobe a texel: `optimum`, which counts single lights alone, and
the same descent where what people see counts alone. All are measured by renders that no method sees. The section is
made where the record `results-whole` is there, too.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from results_sets import folder_sets, middle
from timing import arguments, keep

from mipbake.baking.methods import METHODS
from mipbake.baking.prefilter import Prefilter
from mipbake.baking.search.methods import Auto, Optimum
from mipbake.comparing.candidates import closed_forms, label
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import DECIBEL, Scores
from mipbake.quality.judging.terms import PICTURES, TERMS, Weight, Weights
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Problem

SETS, SIDE = 9, 64
"""Sets that are measured, spread over the folder, and texels a side of the part in their middle."""

AIMS = (0.0, 0.25, 0.5, 0.75, 1.0)
LIMIT = "limit of the visible error"
PICTURES_ALONE = Weights({name: Weight(float(name in PICTURES), 0.0) for name in TERMS}, group_behind=0.0)
"""Weights of which nothing counts but what people see."""

EFFORT = ProbeEffort(groups=32, samples=16, pictures=96, picture_samples=32)
SEED = 987  # of renders that measure
MODEL, FILTER = "gltf", "gaussian"


def methods() -> Iterator[tuple[str, Prefilter, str]]:
    """Name, method and kernel of all that is measured."""
    for name, kernel in closed_forms(FILTER):
        yield label(name, kernel), METHODS[name], kernel
    yield "neural", METHODS["neural"], FILTER
    for aim in AIMS:
        yield f"auto, aim {aim:g}", Auto(aim=aim), FILTER
    yield "optimum", Optimum(), FILTER
    yield LIMIT, Optimum(judged_by=PICTURES_ALONE), FILTER


def measured(problem: Problem) -> dict[str, dict[str, float]]:
    """Method to its figures, in the mean over levels of detail: SNR by pair set in dB, and visible error by kind of
    picture, its geometric mean."""
    scores = Scores(problem, EFFORT, SEED)
    found = {}
    for name, method, kernel in methods():
        args = problem.stored, problem.source, problem.target, kernel, problem.wrap
        stack = method(*args, lambda _: None).levels
        logs = dict(zip(TERMS, np.mean([each.terms for each in scores.of_stack(stack)], 0), strict=True))
        snr = {pairs: float(-DECIBEL * logs[pairs]) for pairs in PAIR_SETS}
        found[name] = {**snr, **{kind: float(np.exp(logs[kind] / 2)) for kind in PICTURES}}
    return found


def main() -> None:
    """Measures, and writes the file."""
    options = arguments(__doc__, "materials", results=None)
    sets = folder_sets(options.materials)
    data: dict[str, Any] = {"side": SIDE, "sets": {}}
    names = sorted(sets)
    for name in (names[index * len(names) // SETS] for index in range(min(SETS, len(names)))):
        started = time.process_time()
        part = middle(sets[name](), SIDE)
        data["sets"][name] = measured(Problem(part.material(MODEL), MODEL, MODEL, FILTER, part.wrap))
        print(f"{name}: {time.process_time() - started:.0f} s", flush=True)
    keep(data, options.results)


if __name__ == "__main__":
    main()
