"""The texels of a stack that lookups at probes read: what is measured of a level does not grow with the level.

Fine levels have millions of texels, and lookups read some ten thousands of them. So of a stack that is measured only,
only these are made, and looked up with the bits of lookups in the whole level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.rules.bands import CHUNK
from mipbake.baking.rules.together import Placed, Together
from mipbake.material import MODELS, MaterialModel
from mipbake.quality.judging.scores import Scores
from mipbake.quality.reference.problem import Image, Problem
from mipbake.sampling.taps import LinearTaps, linear_taps

MOST = 0.25  # share of a level's texels that lookups read from which on all of its texels are made


class Touched:
    """Averages of closed forms at the texels that lookups read.

    Args:
        sets: of renders, by all of whose probes stacks are looked up.
    """

    def __init__(self, problem: Problem, sets: Sequence[Scores]) -> None:
        self._problem, self._sets = problem, sets
        self._texels: list[NDArray[np.int64] | None] = []
        self._taps: dict[tuple[int, int, int], LinearTaps] = {}
        self._averages: list[dict[str, Image]] = []
        at = [(which, index) for which, each in enumerate(sets) for index in range(len(each.probes))]
        for level, size in enumerate(problem.sizes):
            here = {
                (which, index): linear_taps(size, sets[which].places(index), problem.wrap)
                for which, index in at
                if level in sets[which].probes[index].levels
            }
            texels = _read(size, [each.texels for each in here.values()])
            self._texels.append(texels)
            for (which, index), taps in here.items():
                placed = taps if texels is None else replace(taps, texels=np.searchsorted(texels, taps.texels))
                self._taps[which, index, level] = placed

    def gather(self, together: Together) -> None:
        """Takes what a pass averages at these texels."""
        counts = [height * width for height, width in self._problem.sizes]
        self._averages = [
            {
                name: np.empty((counts[level] if texels is None else len(texels), width), np.float32)
                for name, width in together.widths(level).items()
            }
            for level, texels in enumerate(self._texels)
        ]

        def take(level: int, rows: slice, averages: Mapping[str, Image]) -> None:
            width, texels = self._problem.sizes[level][1], self._texels[level]
            first, last = rows.start * width, rows.stop * width
            here, own = slice(first, last), slice(None) if texels is None else texels[:0]
            if texels is not None:
                here = slice(*np.searchsorted(texels, (first, last)).tolist())
                own = texels[here] - first
            for name, each in averages.items():
                self._averages[level][name][here] = each.reshape(-1, each.shape[-1])[own]

        together.show(take)

    def made(self, form: Placed, level: int, model: MaterialModel | None = None) -> Image:
        """(N, C) the texels of a form at a level, in a model; None for the target."""
        averages = {name: self._averages[level][name] for name in form.reads(level)}
        channels = (model or MODELS[self._problem.target]).channels
        out = np.empty((len(averages[form.kernel]), channels), np.float32)
        for start in range(0, len(out), CHUNK):
            some = slice(start, start + CHUNK)
            planes = {name: np.ascontiguousarray(each[some].T) for name, each in averages.items()}
            out[some] = form.made(planes, level)
        return out

    def seen(self, texels: Image, which: int, index: int, level: int) -> Image:
        """What a probe of a set sees of (N, C) texels of a level."""
        return self._sets[which].seen(self._taps[which, index, level].mixed(texels), index)


def _read(size: tuple[int, int], lookups: Sequence[NDArray[np.int64]]) -> NDArray[np.int64] | None:
    """Which texels lookups read, in order; None where they are so many that all are made."""
    height, width = size
    marked = np.zeros(height * width, bool)
    for each in lookups:
        marked[each.ravel()] = True
    texels = np.flatnonzero(marked)
    return None if len(texels) >= MOST * len(marked) else texels
