"""What the weights of the judge do: each halved and doubled, and what `auto` makes of sets then.

    python docs/remake.py --measure weights --materials MATERIALS    measures, and makes RESULTS-weights.md
    python benchmarks/weights.py MATERIALS                 measures, and prints the table

MATERIALS is a folder of texture sets that nothing is tested on: weights are chosen here. The middle of a few of them is
baked by `auto`, and measured by renders that `auto` never sees.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from results_sets import folder_sets, middle
from timing import arguments
from timing import table as markdown

from mipbake.baking.search.methods import Auto
from mipbake.material.aim import DEFAULT_AIM
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import DECIBEL, Scores
from mipbake.quality.judging.terms import TERMS, Weights, weights_for
from mipbake.quality.reference.problem import Problem

SETS, SIDE = 6, 256
"""Sets that are measured, spread over the folder, and texels a side of the part in their middle."""

EFFORT = ProbeEffort(groups=48, samples=16, pictures=64, picture_samples=32)
SEED = 987  # of renders that measure
MODEL, FILTER = "gltf", "gaussian"
WEIGHTS = weights_for(DEFAULT_AIM)


def changed() -> Iterator[tuple[str, Weights]]:
    """What is measured: the weights as they are, and with one change each."""
    yield "as they are", WEIGHTS
    for name, weight in WEIGHTS.terms.items():
        for word, factor in (("half", 0.5), ("twice", 2.0)):
            scaled = replace(weight, counts=factor * weight.counts, behind=factor * weight.behind)
            yield f"{name}: {word}", replace(WEIGHTS, terms={**WEIGHTS.terms, name: scaled})
    for word, factor in (("half", 0.5), ("twice", 2.0)):
        behind = {name: replace(each, behind=factor * each.behind) for name, each in WEIGHTS.terms.items()}
        yield f"behind, all terms: {word}", replace(WEIGHTS, terms=behind)
        yield f"behind, groups: {word}", replace(WEIGHTS, group_behind=factor * WEIGHTS.group_behind)
    for chance in (0.0, 1.0):
        yield f"chance: {chance:g} standard errors", replace(WEIGHTS, chance=chance)


def measured(problem: Problem, scores: Scores, weights: Weights) -> NDArray[np.float64]:
    """(M, T) decibels of all terms at all levels of detail, of what `auto` makes."""
    args = problem.stored, problem.source, problem.target, problem.pixel_filter, problem.wrap
    result = Auto(judged_by=weights)(*args, lambda _: None)
    return np.stack([-DECIBEL * each.terms for each in scores.of_stack(result.levels)])


def table(found: Mapping[str, NDArray[np.float64]]) -> str:
    """Markdown of (sets, M, T) decibels: the first row in decibels, the others as gains over it."""
    base, rows = next(iter(found.values())), []
    for name, each in found.items():
        gains = (each - base).mean(1)
        error = gains.std(0) / np.sqrt(max(1, len(gains) - 1))
        cells = [f"{gain:+.2f} ± {chance:.2f}" for gain, chance in zip(gains.mean(0), error, strict=True)]
        cells = cells if each is not base else [f"{value:.1f}" for value in base.mean((0, 1))]
        rows.append([name, *cells])
    return markdown(["change", *TERMS], rows)


def main() -> None:
    """Prints the table."""
    sets = folder_sets(arguments(__doc__, "materials").materials)
    names = sorted(sets)[:: max(1, len(sets) // SETS)][:SETS]
    found: dict[str, list[NDArray[np.float64]]] = {}
    for name in names:
        part = middle(sets[name](), SIDE)
        problem = Problem(part.material(MODEL), MODEL, MODEL, FILTER, part.wrap)
        scores = Scores(problem, EFFORT, SEED)
        for change, weights in changed():
            found.setdefault(change, []).append(measured(problem, scores, weights))
    print(f"Sets: {', '.join(f'`{name}`' for name in names)}; the middle {SIDE} x {SIDE} texels of each.\n")
    print(table({change: np.stack(each) for change, each in found.items()}))


if __name__ == "__main__":
    main()
