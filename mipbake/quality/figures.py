"""What is measured: methods, candidates, scales and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.material.aim import Sampler

SCALES: Mapping[str, tuple[float, float]] = {
    "near": (0.0, 0.0),
    "1:1": (0.0, 1.0),
    "middle": (3.0, 3.0),
    "far": (7.0, 7.0),
}
"""Name and range of levels of detail of every scale; a set with fewer levels has `far` at its last one. Not tuned:
figures are defined by them."""

SNR_GAIN = "snr-gain"
"""Measure of a figure that is the subject's SNR minus the SNR of the figure's method, over the same light-view
pairs."""


@dataclass(frozen=True)
class Method:
    """One of the stacks that were compared.

    Args:
        name: what tables and files call it: `neural`, `linear (box)`, or `baked` for a stack that was opened.
        method, kernel: how it was prefiltered, and with which averaging kernel (the pixel filter it is made for, where
            the method averages nothing).
        model: material model of its channels.
        seconds: that baking took; None for a stack that was opened.
        path: the folder of a stack that was opened.
        sampler, aim: what it was made for, as its provenance has them; None for methods that take none.
    """

    name: str
    method: str
    kernel: str
    model: str
    seconds: float | None = None
    path: Path | None = None
    sampler: Sampler | None = None
    aim: float | None = None


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Args:
        method: name of the method.
        measure: a name in `mipbake.quality.metrics.MEASURES`, or SNR_GAIN.
        view: what was looked at: a pair set (`near-mirror`, `hemisphere`) in texture space, or the name of a kind of
            render (`sphere`, `plane`, ...) or of a film (`film-floor`, ...).
        scale: a name in SCALES; empty for a render of all scales, for a film and for a point of a curve.
        lod: level of detail of a point of a curve, or the median of a render; of a scale that is a range, its middle.
        value: the figure. low, high: its 95 % confidence interval; nan where it has none.
    """

    method: str
    measure: str
    view: str
    scale: str
    lod: float
    value: float
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True, eq=False)
class Candidate:
    """A stack that is measured.

    Args:
        method: what it is.
        levels: (H_L, W_L, C) float32 stored channels of the model `method.model`, finest first, down to 1 x 1. The
            levels from `bake_all` may lie in files: they are read-only, and are gone after its block.
    """

    method: Method
    levels: Sequence[NDArray[np.float32]]

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Candidate({self.name!r}, {self.method.model}, {len(self.levels)} levels)"

    @property
    def name(self) -> str:
        """What tables and files call it."""
        return self.method.name
