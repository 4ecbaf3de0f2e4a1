"""Closed forms in two passes over the image: texels that lookups at probes read, and levels summed from ingredients.

Fine levels have millions of texels, and lookups read some ten thousands of them. So of a stack that is measured only,
only these are made, and looked up with the bits of lookups in the whole level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.rules.bands import CHUNK
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.together import Placed, Together
from mipbake.base import memory
from mipbake.material import MODELS, MaterialModel
from mipbake.quality.judging.scores import Scores
from mipbake.quality.reference.problem import Image, Problem
from mipbake.sampling.taps import LinearTaps, linear_taps

Array = NDArray[np.float64]

MOST = 0.25  # share of a level's texels that lookups read from which on all of its texels are made


class Touched:
    """Averages of closed forms at the texels that lookups read.

    Args:
        sets: of renders at every level, by all of whose probes stacks are looked up.
    """

    def __init__(self, problem: Problem, sets: Sequence[Scores]) -> None:
        self._problem, self._sets = problem, sets
        self._texels: list[NDArray[np.int64] | None] = []
        self._taps: list[list[LinearTaps]] = []
        self._averages: list[dict[str, Image]] = []
        for level, size in enumerate(problem.sizes):
            here = [linear_taps(size, scores.places(level), problem.wrap) for scores in sets]
            texels = _read(size, [each.texels for each in here])
            self._texels.append(texels)
            if texels is not None:
                here = [replace(taps, texels=np.searchsorted(texels, taps.texels)) for taps in here]
            self._taps.append(here)

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

    def seen(self, texels: Image, which: int, level: int) -> Image:
        """What a probe of a set sees of (N, C) texels of a level."""
        return self._sets[which].seen(self._taps[level][which].mixed(texels), level)


def _read(size: tuple[int, int], lookups: Sequence[NDArray[np.int64]]) -> NDArray[np.int64] | None:
    """Which texels lookups read, in order; None where they are so many that all are made."""
    height, width = size
    marked = np.zeros(height * width, bool)
    for each in lookups:
        marked[each.ravel()] = True
    texels = np.flatnonzero(marked)
    return None if len(texels) >= MOST * len(marked) else texels


def mixed(
    problem: Problem,
    whole: Whole,
    forms: Mapping[str, tuple[Form, str]],
    baked: Mapping[str, list[Image]],
    mixtures: Sequence[Mapping[str, Array]],
) -> list[Image]:
    """The levels of mixtures, one each, made valid.

    Args:
        forms: closed forms of the image with their kernels, by name. baked: levels of all other ingredients; the first
            of them are written over.
        mixtures: names and (C,) shares of what each level is summed from.
    """
    target = problem.target
    names = list(dict.fromkeys(name for mixture in mixtures for name in mixture))
    shares = [{name: mixture[name].astype(np.float32) for name in names if name in mixture} for mixture in mixtures]
    used = [name for name in names if name in forms]
    together = Together(whole, [forms[name] for name in used], problem.wrap) if used else None
    placed = dict(zip(used, together.placed if together is not None else (), strict=True))
    first = next((baked[name] for name in names if name in baked), None)
    shapes = [(*size, MODELS[target].channels) for size in problem.sizes]
    out = first or [memory.empty(shape) for shape in shapes]

    def take(level: int, rows: slice, averages: Mapping[str, Image]) -> None:
        own, width = shares[level], problem.sizes[level][1]
        read = {each for name in own if name in placed for each in placed[name].reads(level)}
        step = max(1, CHUNK // width)
        for start in range(rows.start, rows.stop, step):
            here = slice(start, min(start + step, rows.stop))
            some = slice(start - rows.start, here.stop - rows.start)
            planes = {name: np.ascontiguousarray(averages[name][some].transpose(2, 0, 1)) for name in read}
            total = np.zeros((shapes[level][2], here.stop - start, width), np.float32).transpose(1, 2, 0)
            for name, share in own.items():
                texels = placed[name].made(planes, level) if name in placed else baked[name][level][here]
                total += texels * share
            out[level][here] = material.regularise(total, target)

    if together is not None:
        together.show(take)
    else:
        for level, (height, _) in enumerate(problem.sizes):
            take(level, slice(0, height), {})
    return out
