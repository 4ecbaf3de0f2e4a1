"""Levels summed from ingredients in one pass over the image: of closed forms no level is ever whole in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.rules.bands import CHUNK
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.together import Together
from mipbake.base import memory
from mipbake.material import MODELS
from mipbake.quality.reference.problem import Image, Problem

Array = NDArray[np.float64]


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
