"""Measures in texture space, of many candidates at once: every pixel covers 2^lod texels, lit by single directions.

All candidates are measured against the same two independent estimates of the reference, at the same pixels, so
whatever differs is a difference of the candidates (texture_sums.py).

Light-view pairs are measured in blocks of 64, and every block has surface points of its own. So 1,024 pairs cost no
more than 64 pairs at as many points, and no figure hangs on how 64 pairs happened to fall.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.base.threads import on_threads
from mipbake.base.timings import PhaseProgress
from mipbake.material.aim import DEFAULT_SAMPLER, Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.figures import SCALES, Candidate, Figure
from mipbake.quality.metrics import PAIR_SETS, Interval, bootstrap, flicker_interval, snr_gain_interval, snr_interval
from mipbake.quality.metrics.pairs import BLOCK
from mipbake.quality.metrics.snr import snr_from_sums
from mipbake.quality.texture_sums import BLOCKS, Draws, Found, Sums, a_block, at_rest, in_motion, whole_scene

DEFAULT_SEED = 0  # not tuned
DEFAULT_POINTS = 8192
DEFAULT_SAMPLES = 64

STEP = 0.25
"""Levels of detail between points of a curve, and within a scale."""

_SIDE_BY_SIDE = 1 << 12
"""Samples of a piece of work from which pieces are worked on side by side: with fewer, threads wait for the
interpreter."""

_TOGETHER = 256
"""Points up to which blocks of pairs are one piece of work: calls for few points take longer than what they do."""

_POINTS_A_PIXEL = 4  # points for flicker that a set of few pixels needs at a level of detail
# Times the samples are spent on flicker there: the reference hardly changes, and noise drowns it.
_FEW_PIXELS_WORK = 8
_LEAST_CHANGE_POINTS = 1024

Where = str | float
"""A scale, by its name in SCALES, or a level of detail."""


@dataclass(frozen=True, eq=False)
class TextureSpace:
    """What was measured in texture space.

    Args:
        curve: the SNR by level of detail; `scale` is empty.
        figures: SNR, tonemapped error, flicker and SNR of the change at every scale. A scale of several levels of
            detail pools their sums.
        notes: what a reader must know, in sentences.
        sums: method, view and place to the sums of the SNR.
    """

    curve: tuple[Figure, ...]
    figures: tuple[Figure, ...]
    notes: tuple[str, ...]
    sums: Mapping[tuple[str, str, Where], Sums]

    def gain(self, method: str, other: str, view: str, where: Where) -> Interval:
        """How many dB of SNR a method is above another at a scale or level of detail, with the interval over pairs.

        Both are resampled together, so the interval says whether their order would stay with other pairs. KeyError
        where one was not measured.
        """
        return snr_gain_interval(self.sums[method, view, where], self.sums[other, view, where])


def last_lod(size: tuple[int, int]) -> float:
    """The last level of a stack of (height, width) texels."""
    return float(len(level_sizes(*size)) - 1)


def curve_lods(size: tuple[int, int]) -> tuple[float, ...]:
    """Levels of detail of a curve: from 0 to the far scale, or to the last level, in steps of STEP."""
    return _steps(0.0, min(SCALES["far"][1], last_lod(size)))


def scale_lods(size: tuple[int, int], scale: str) -> tuple[float, ...]:
    """Levels of detail that a scale is measured at: its own, or the last level where the set has no more."""
    low, high = (min(lod, last_lod(size)) for lod in SCALES[scale])
    return _steps(low, high)


def check_settings(lods: Sequence[float] | None, points: int, samples: int) -> None:
    """UsageError for what `measure` would refuse, so that nobody bakes for it."""
    if lods is not None and not (lods and all(0 <= lod < float("inf") for lod in lods)):
        raise UsageError(f"lods must be one or more numbers from 0 up, got {list(lods)}")
    if points < 1 or samples < 1:
        raise UsageError(f"points and samples must be at least 1, got {points} and {samples}")


PHASE = "texture space"
"""What `measure` calls its work."""


def _change_draws(pixels: float, points: int, samples: int) -> tuple[int, int]:
    """Points and samples for flicker where the set has so many pixels: half of the samples of the SNR, or more."""
    most = max(1, points // 2)
    count = min(most, max(_LEAST_CHANGE_POINTS, round(_POINTS_A_PIXEL * pixels)))
    return count, samples if count == most else max(samples, _FEW_PIXELS_WORK * most * samples // count)


@dataclass(frozen=True)
class MeasureEffort:
    """The random numbers of a measurement, and how many.

    Args:
        seed: fixes points, light-view pairs and samples.
        points: random pixels per level of detail, an equal share for every block of pairs, and at least one; fewer
            carry the tonemapped error and flicker.
        samples: of the reference per pixel, in each of two estimates; beside scales, half of them between scales.
        intervals: whether the SNR of the curve has confidence intervals, which take thousands of draws.
    """

    seed: int = DEFAULT_SEED
    points: int = DEFAULT_POINTS
    samples: int = DEFAULT_SAMPLES
    intervals: bool = True


def measure(
    source: FilteredSource,
    candidates: Sequence[Candidate],
    lods: Sequence[float] | None = None,
    scales: Sequence[str] = tuple(SCALES),
    effort: MeasureEffort = MeasureEffort(),
    progress: PhaseProgress = lambda _phase, _share: None,
    sampler: Sampler = DEFAULT_SAMPLER,
) -> TextureSpace:
    """Measures candidates against the pixel-filtered reference of their source, with 95 % intervals over pairs.

    Candidates are looked up as the sampler looks up footprints that are round. The reference is estimated twice, so
    that its noise biases neither the SNR nor flicker; the tonemapped error counts it as error.

    For flicker, pixels move by SHIFTS. Both estimates are drawn anew at every place, with no random number shared, so
    that noise in one estimate is not a change in the other estimate as well. Where the set has few pixels at a level of
    detail, fewer points take many more samples each: the reference hardly changes there, and its noise must be less.

    Args:
        source: level 0, and the pixel filter that the reference has.
        candidates: stacks of it, with distinct names.
        lods: levels of detail of the curve; None for `curve_lods`. Those beyond the last level are measured there,
            once.
        scales: names in SCALES; none for the curve alone.
        effort: the random numbers, and how many.
        sampler: that looks the stacks up.

    Raises:
        UsageError: no lod or a negative one, fewer than one point or sample, an unknown pixel filter.
    """
    height, width = size = source.size
    wanted = curve_lods(size) if lods is None else tuple(float(lod) for lod in lods)
    check_settings(wanted, effort.points, effort.samples)
    seed, points, samples = effort.seed, effort.points, effort.samples
    last = last_lod(size)
    curve = tuple(dict.fromkeys(min(lod, last) for lod in wanted))
    notes = () if curve == wanted else (f"lods beyond the last level were measured there, at lod {last:g}.",)
    at_scale = {scale: scale_lods(size, scale) for scale in scales}
    shifted = {lod for each in at_scale.values() for lod in each}
    every = tuple(dict.fromkeys((*curve, *sorted(shifted))))

    scene, own = whole_scene(source, seed, sampler), a_block(points)
    together = max(1, min(BLOCKS, _TOGETHER // own))
    parts = [slice(first, first + together) for first in range(0, BLOCKS, together)]
    drawn = {lod: _change_draws(width * height / 4**lod, points, samples) for lod in shifted}

    def measured(item: int) -> list[Found]:
        index, part = divmod(item, len(parts))
        lod, some = every[index], scene[parts[part]]
        rngs = [np.random.default_rng([seed, index, block]) for block in range(BLOCKS)[parts[part]]]
        # Noise does not bias the SNR, which is all that places between scales have.
        taken = samples if lod in shifted or not shifted else max(1, samples // 2)
        found = list(at_rest(some, candidates, lod, Draws(own, taken, rngs), lod in shifted))
        if lod in shifted:
            count, most = drawn[lod]
            found += in_motion(some, candidates, lod, Draws(a_block(count), most, rngs))
        return found

    sums: dict[tuple[str, str, float], list[Sums]] = {}  # as Found, the pair sets of every block one after the other
    side_by_side = together * own * samples >= _SIDE_BY_SIDE
    items = len(every) * len(parts)
    for pieces in on_threads(measured, items, partial(progress, PHASE), None if side_by_side else 1):
        for key, rows in pieces:
            sums.setdefault(key, []).extend(rows)
    progress(PHASE, 1.0)
    named = [(each.name, view) for each in candidates for view in PAIR_SETS]
    pooled = {
        (measure, name, view, scale): np.sum([_of_set(sums[measure, name, lod], view) for lod in at], 0)
        for name, view in named
        for measure in _MEASURES
        for scale, at in at_scale.items()
    }
    snr: dict[tuple[str, str, Where], Sums] = {
        (name, view, lod): _of_set(sums["snr", name, lod], view) for name, view in named for lod in every
    }
    snr |= {(name, view, scale): rows for (measure, name, view, scale), rows in pooled.items() if measure == "snr"}
    middle = {scale: (at[0] + at[-1]) / 2 for scale, at in at_scale.items()}
    figures = tuple(_figure(*key, middle[key[-1]], rows) for key, rows in pooled.items())
    of_curve = _figure if effort.intervals else _bare_snr
    return TextureSpace(
        curve=tuple(
            of_curve("snr", name, view, "", lod, snr[name, view, lod]) for name, view in named for lod in curve
        ),
        figures=figures,
        notes=(*notes, *_unresolved(figures)),
        sums=snr,
    )


_MEASURES: Mapping[str, Callable[[Sums], Interval]] = {
    "snr": snr_interval,
    "tonemapped": lambda sums: bootstrap(lambda total: total[..., 0] / total[..., 1], sums),
    "flicker": flicker_interval,
    "flicker-snr": snr_interval,
}
"""Figures from the sums of each measure, by its name in `mipbake.quality.metrics.MEASURES`."""


def _figure(measure: str, method: str, view: str, scale: str, lod: float, sums: Sums) -> Figure:
    interval = _MEASURES[measure](sums)
    return Figure(method, measure, view, scale, lod, interval.estimate, interval.low, interval.high)


def _bare_snr(measure: str, method: str, view: str, scale: str, lod: float, sums: Sums) -> Figure:
    """An SNR without its interval."""
    return Figure(method, measure, view, scale, lod, float(snr_from_sums(sums.sum(0))))


def _unresolved(figures: Sequence[Figure]) -> list[str]:
    """A sentence where flicker has no figure: what the reference changes by is the same for all methods."""
    at = dict.fromkeys(
        f"{figure.scale} ({figure.view})"
        for figure in figures
        if figure.measure == "flicker" and math.isnan(figure.value)
    )
    if not at:
        return []
    return [
        f"flicker has no figure at {', '.join(at)}: half a pixel changes the reference by less than its noise, or by "
        "nothing; more samples may tell."
    ]


def _of_set(blocks: Sequence[Sums], name: str) -> Sums:
    """(PAIRS, M): the rows of one pair set, of all blocks."""
    first = list(PAIR_SETS).index(name) * BLOCK
    return np.concatenate([rows[first : first + BLOCK] for rows in blocks])


def _steps(low: float, high: float) -> tuple[float, ...]:
    """Numbers from low to high, both included, in steps of STEP."""
    return tuple(dict.fromkeys((*(float(lod) for lod in np.arange(low, high, STEP)), high)))
