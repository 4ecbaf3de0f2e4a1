"""What files give back where they are sampled: at every level, and halfway between two.

A lookup between levels averages both. Where each of them is right and the average is not, what they store does not
belong together: directions of opposite signs, say. No texture set is the cause of that, and no figure at whole levels
shows it. So every output is measured as it was written and read back, halfway between levels too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.metrics.snr import snr_from_sums
from mipbake.quality.texture_space import MeasureEffort, TextureSpace, measure
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack

WORST_DIP = 2.0
"""dB by which a lookup between two levels may be worse than at both of them: more is a defect of what made them."""

LEAST_SNR = 3.0
"""dB that both levels have where a dip counts. Where the error is as great as what is to be seen, as with plain
averages of bumpy gloss, a lookup between levels may well be worse than at both."""

SPOKEN = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere"}
"""Pair sets, in a sentence."""

BAKED = "baked"
"""Name of a stack that was opened."""

_POINTS, _LEAST_POINTS, _SAMPLES, _SEED = 256, 16, 16, 12  # efforts: guesses; the last is the seed
_SUSPICIOUS = 1.0  # dB of a dip that is measured again, with more points and other pairs
_SURE_POINTS, _SURE_SAMPLES, _SURE_SEED = 1024, 32, 13  # efforts: guesses; the last is the seed
# Pairs: means over groups of decibels do not hang on the few brightest pairs; as in judging/pairs.py; not tuned here.
_GROUP = 64


@dataclass(frozen=True)
class Dip:
    """Two levels of LEAST_SNR and more between which lookups are worse than at both, by more than WORST_DIP.

    Args:
        pair_set: that shows it. lod: halfway between the levels. snr: there, in dB. at_levels: at both.
    """

    pair_set: str
    lod: float
    snr: float
    at_levels: tuple[float, float]

    def __str__(self) -> str:
        low, high = math.floor(self.lod), math.ceil(self.lod)
        return (
            f"{self.snr:.1f} dB at lod {self.lod:g}, {self.at_levels[0]:.1f} and {self.at_levels[1]:.1f} dB at lods "
            f"{low} and {high} ({SPOKEN[self.pair_set]})"
        )


@dataclass(frozen=True)
class Written:
    """SNR of the files of one output against the pixel-filtered reference, as a GPU samples them.

    Args:
        lods: from 0 to the last level in steps of 1/2.
        snr: pair set to dB at each.
        dips: between two levels that do not belong together; empty unless mipbake has a defect.
    """

    lods: tuple[float, ...]
    snr: Mapping[str, tuple[float, ...]]
    dips: tuple[Dip, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON: figures to a tenth of a decibel, which is what they are worth."""
        return {
            "lods": list(self.lods),
            "snr": {name: [_plain(value) for value in row] for name, row in self.snr.items()},
            "dips": [
                {**asdict(dip), "snr": _plain(dip.snr), "at_levels": [_plain(value) for value in dip.at_levels]}
                for dip in self.dips
            ],
        }


def opened(stack: MipStack, path: Path | None = None) -> Candidate:
    """An existing stack as the candidate `baked`; the path is the folder that it was opened from."""
    made = stack.provenance
    method = Method(BAKED, made.method, made.pixel_filter, stack.model, path=path, sampler=made.sampler, aim=made.aim)
    return Candidate(method, stack.levels)


def measure_written(
    texture_set: TextureSet,
    stack: MipStack,
    levels: Sequence[NDArray[np.float32]],
    progress: Callable[[float], None] = lambda _share: None,
) -> Written:
    """Measures levels as they were read back.

    A dip that few pixels show may be chance. So it is measured again, with more pixels and other pairs, and counts
    where both the SNR of all pairs and the mean SNR of groups of them have it.

    Args:
        texture_set: that the stack was baked from, nothing in it hidden (`mipbake.source.opacity.shown`).
        levels: (H_L, W_L, C) stored channels that the files hold, finest first.
    """
    found = Candidate(replace(opened(stack).method, name="written"), levels)
    lods = [index / 2 for index in range(2 * len(levels) - 1)]
    texels = texture_set.width * texture_set.height
    points = min(_POINTS, max(_LEAST_POINTS, texels // 4))
    source = texture_set.filtered(stack.provenance.pixel_filter)
    sampler = stack.provenance.sampler or DEFAULT_SAMPLER

    def measured(at: Sequence[float], points: int, samples: int, seed: int) -> TextureSpace:
        told = (lambda _phase, share: progress(share)) if at is lods else (lambda _phase, _share: None)
        effort = MeasureEffort(seed, points, samples, intervals=False)
        return measure(source, [found], at, (), effort, told, sampler)

    first = measured(lods, points, _SAMPLES, _SEED)
    dips = []
    for low in range(len(levels) - 1):
        around = (float(low), low + 0.5, low + 1.0)
        if all(_dip(first, view, around, _in_groups) < _SUSPICIOUS for view in PAIR_SETS):
            continue
        again = measured(around, max(points, min(_SURE_POINTS, texels)), _SURE_SAMPLES, _SURE_SEED)
        for view in PAIR_SETS:
            if all(_dip(again, view, around, figure) > WORST_DIP for figure in (_in_groups, _of_all)):
                at = [_of_all(again, view, lod) for lod in around]
                dips.append(Dip(view, around[1], at[1], (at[0], at[2])))
    progress(1.0)
    snr = {view: tuple(_of_all(first, view, lod) for lod in lods) for view in PAIR_SETS}
    return Written(tuple(lods), snr, tuple(dips))


_Figure = Callable[[TextureSpace, str, float], float]


def _dip(found: TextureSpace, view: str, around: tuple[float, float, float], figure: _Figure) -> float:
    """dB by which the middle is below the lower end; -inf where that has less than LEAST_SNR, or nothing is lit."""
    low, middle, high = (figure(found, view, lod) for lod in around)
    ends = min(low, high)
    return ends - middle if ends >= LEAST_SNR and not math.isnan(middle) else -math.inf


def _of_all(found: TextureSpace, view: str, lod: float) -> float:
    """SNR of all pairs."""
    return float(snr_from_sums(found.sums["written", view, lod].sum(0)))


def _in_groups(found: TextureSpace, view: str, lod: float) -> float:
    """Mean SNR of groups of pairs."""
    rows = found.sums["written", view, lod]
    return float(np.nanmean(snr_from_sums(rows.reshape(-1, _GROUP, rows.shape[-1]).sum(1))))


def _plain(value: float) -> float | None:
    return round(value, 1) if math.isfinite(value) else None
