"""The promise of a search: what its witness found of the stack."""

from __future__ import annotations

import numpy as np

from mipbake.baking.search.stages import Search
from mipbake.quality.judging.judge import standard_error
from mipbake.quality.judging.pairs import SET_SIZE
from mipbake.quality.judging.scores import DECIBEL, Array
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.stack.promise import BetweenPromise, LevelPromise, Promise


def promised(search: Search) -> Promise:
    """What the witness found of every level, and halfway between levels."""
    start, sets = search.blend, list(PAIR_SETS)
    found = start.witness.of_stack(search.levels)
    levels, between = [], []
    for lod, score, rivals in zip(start.witness.lods, found, start.witnessed, strict=True):
        rows, others = score.log_errors, np.stack([rival.log_errors for rival in rivals])

        def by_set(values: Array) -> dict[str, float]:
            return {name: round(float(value), 4) for name, value in zip(sets, values, strict=True)}

        figures = {
            "snr": by_set(-DECIBEL * rows.mean(1)),
            "standard_error": by_set(DECIBEL * standard_error(rows)),
            "best_closed_form_snr": by_set(-DECIBEL * others.mean(1)),
            "gain_error": by_set(DECIBEL * standard_error(rows - others)),
        }
        best = {name: rival.name for name, rival in zip(sets, rivals, strict=True)}
        if lod == int(lod):
            level = int(lod)
            sources, kept = start.sources[level], search.kept[level]
            levels.append(LevelPromise(best_closed_form=best, level=level, sources=sources, refined=kept, **figures))
        else:
            between.append(BetweenPromise(best_closed_form=best, lod=lod, **figures))
    effort = start.witness.effort
    pairs, points = effort.groups * SET_SIZE, effort.groups * effort.points
    visible = np.exp(np.mean([score.seen.mean(-1) for score in found] - start.plain))
    return Promise(tuple(levels), pairs, points, start.left_out, tuple(between), round(float(visible), 4))
