"""Confidence intervals over light-view pairs: the percentile bootstrap.

A figure is taken over pairs that were drawn at random. All are drawn from one density, and a row of sums has the weight
of its pair in it, so rows are alike. The pairs are stratified, which the bootstrap does not know: intervals are
somewhat too wide for that.
The interval says how far the figure would move with other pairs of the same set. It says nothing of other materials,
nor of the pixels and samples, which are many. Efron and Tibshirani 1993, "An introduction to the bootstrap", chapter
13: pairs are drawn with replacement, as many as there are, and the interval holds the middle of the figures of many
such draws. It needs no formula for the spread of a ratio of sums; with few pairs or heavy tails it is somewhat too
narrow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.metrics.flicker import flicker_ratio_from_sums
from mipbake.quality.metrics.snr import snr_from_sums

_RESAMPLES, _SEED = 2000, 0

Statistic = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""(..., M) sums over pairs to (...) figures."""


@dataclass(frozen=True)
class Interval:
    """A figure of all pairs with its 95 % confidence interval, `low` not above `high`; both are nan where the figure is
    nan for a resample."""

    estimate: float
    low: float
    high: float


def bootstrap(statistic: Statistic, sums: NDArray[np.floating]) -> Interval:
    """The interval of a figure that depends on sums over pairs.

    Figures of as many pairs share their draws, so their order is not blurred by chance.

    Args:
        statistic: from sums over pairs, (..., M), to the figures (...).
        sums: (K, M), what each pair adds; K at least 2. A resample weights the rows by how often it drew each.
    """
    rows = np.asarray(sums, np.float64)
    figures = statistic(_draws(len(rows)) @ rows)
    tail = 50 * (1 - 0.95)
    low, high = np.percentile(figures, [tail, 100 - tail]) if np.isfinite(figures).all() else (math.nan, math.nan)
    return Interval(float(statistic(rows.sum(0))), float(low), float(high))


@lru_cache(maxsize=8)
def _draws(count: int) -> NDArray[np.float64]:
    """(_RESAMPLES, count): how often each resample drew each pair. Drawing takes far longer than the figures do."""
    drawn = np.random.default_rng(_SEED).multinomial(count, np.full(count, 1 / count), _RESAMPLES).astype(np.float64)
    drawn.flags.writeable = False
    return drawn


def snr_interval(sums: NDArray[np.floating]) -> Interval:
    """Interval of an SNR in dB from the (K, 3) rows of snr_sums."""
    return bootstrap(snr_from_sums, sums)


def snr_gain_interval(sums: NDArray[np.floating], baseline: NDArray[np.floating]) -> Interval:
    """Interval of SNR - baseline's SNR, in dB, from the (K, 3) rows of snr_sums of both on the same pairs.

    Each resample draws the same pairs for both, so what both find hard cancels. An interval that holds 0 shows no gain.
    """
    both = np.concatenate([sums, baseline], -1)
    return bootstrap(lambda sums: snr_from_sums(sums[..., :3]) - snr_from_sums(sums[..., 3:]), both)


def flicker_interval(sums: NDArray[np.floating]) -> Interval:
    """Interval of a flicker ratio from the (K, 3) rows of flicker_sums, K along the frames' axis of pairs."""
    return bootstrap(flicker_ratio_from_sums, sums)


def mean_interval(values: NDArray[np.floating]) -> Interval:
    """Interval of the mean of (K,) figures, one a pair (or one an image, where images are what was drawn)."""
    column = np.asarray(values, np.float64).reshape(-1, 1)
    return bootstrap(lambda sums: sums[..., 0] / sums[..., 1], np.concatenate([column, np.ones_like(column)], -1))
