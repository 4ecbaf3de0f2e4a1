"""Every method, those that search with little effort."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.baking.methods import METHODS, Prefilter
from mipbake.baking.search.methods import Auto, Optimum, Refine
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.quality.judging.probes import ProbeEffort

FEW = ProbeEffort(groups=2, points=4, samples=2, pictures=8, picture_samples=2)
NONE = DescentEffort(rounds=0, pairs=4, samples=2, looks=FEW)
ONE = DescentEffort(rounds=1, pairs=8, looks=FEW)


def quick_methods(descent: DescentEffort = ONE, effort: ProbeEffort = FEW) -> Mapping[str, Prefilter]:
    """What every method promises does not hang on how long its descents take."""
    searching = (
        Auto(effort=effort, descent=descent),
        Refine(budget="best", effort=effort, descent=descent),
        Optimum(effort=effort, descent=descent),
    )
    return {**METHODS, **{method.name: method for method in searching}}
