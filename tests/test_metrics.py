"""Pair sets, measures that are ratios of sums (SNR, flicker), and confidence intervals over light-view pairs."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.quality.metrics import PAIR_SETS, pair_set
from mipbake.quality.metrics.flicker import flicker_ratio, flicker_ratio_from_sums, flicker_snr_db, flicker_sums
from mipbake.quality.metrics.intervals import flicker_interval, mean_interval, snr_gain_interval, snr_interval
from mipbake.quality.metrics.snr import MAX_SNR_DB, snr_db, snr_sums


@pytest.mark.parametrize("name", PAIR_SETS)
def test_pairs_are_unit_above_the_horizon_and_fixed_by_the_seed(name: str) -> None:
    pairs = pair_set(name, 5)
    for directions in (pairs.light, pairs.view):
        assert directions.shape == (1024, 3)
        assert np.linalg.norm(directions, axis=-1) == pytest.approx(1, abs=1e-6)
        assert directions[:, 2].min() > 0
    assert (pair_set(name, 5).light == pairs.light).all()
    assert not np.allclose(pair_set(name, 6).light, pairs.light)


def test_near_mirror_lights_spread_around_the_mirror_direction() -> None:
    pairs = pair_set("near-mirror", 0, 100_000)
    steep = pairs.view[:, 2] > 0.7  # far from the horizon, where nothing is redrawn
    mirror = pairs.view[steep] * [-1, -1, 1]
    angle = np.arccos(np.clip((pairs.light[steep] * mirror).sum(-1), -1, 1))
    # Two of the Gaussian's three components turn the direction: a Rayleigh distribution of scale 0.12.
    assert angle.mean() == pytest.approx(0.12 * np.sqrt(np.pi / 2), rel=0.02)


def test_reference_noise_does_not_bias_snr() -> None:
    rng = np.random.default_rng(0)
    truth = rng.random((200, 2000)) + 0.5
    candidate = truth + 0.05 * rng.standard_normal(truth.shape)
    noisy = [truth + 0.2 * rng.standard_normal(truth.shape) for _ in range(2)]
    exact = snr_db(candidate, truth, truth)
    assert snr_db(candidate, *noisy) == pytest.approx(exact, abs=0.2)
    assert snr_db(candidate, noisy[0], noisy[0]) < exact - 10


def test_chance_reports_no_perfection() -> None:
    """A right candidate under a noisy reference: the estimated error is often negative, the figure stays finite."""
    truth = np.ones((8, 50))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        first, second = (truth + 0.3 * rng.standard_normal(truth.shape) for _ in range(2))
        assert snr_db(truth, first, second) < 10 * np.log10(1 / (0.01 * 0.3**2)) + 2


def test_no_error_and_no_signal() -> None:
    ones = np.ones((2, 2), np.float32)
    assert snr_db(ones, ones, ones) == MAX_SNR_DB
    assert np.isnan(snr_db(ones, ones * 0, ones * 0))


@pytest.mark.parametrize("name", PAIR_SETS)
def test_views_are_stratified_in_every_block_and_in_the_whole(name: str) -> None:
    view = pair_set(name, 3).view.astype(float)
    assert len(view) == 1024
    cells = np.stack([1 - np.square(view[:, 2]), np.arctan2(view[:, 1], view[:, 0]) / (2 * np.pi) % 1], -1)
    for side, count in ((8, 64), (32, 1024)):
        for start in range(0, 1024, count):
            inside = np.minimum((cells[start : start + count] * side).astype(int), side - 1)
            taken = {(int(i), int(j)) for i, j in inside}
            assert len(taken) >= 0.97 * count  # directions are rounded to float32 near the edges of cells


def estimates(seed: int = 0, noise: float = 0.1, shape: tuple[int, ...] = (16, 500, 3)):
    rng = np.random.default_rng(seed)
    truth = rng.random(shape) + 0.5
    first, second = (truth + noise * rng.standard_normal(shape) for _ in range(2))
    return truth + 0.05 * rng.standard_normal(shape), first, second


def test_snr_refuses_shapes_that_do_not_fit_and_passes_nan_on() -> None:
    p, r1, r2 = estimates()
    with pytest.raises(UsageError, match=r"second has shape \(1, 500, 3\) and first \(16, 500, 3\)"):
        snr_db(p, r1, r2[:1])
    with pytest.raises(UsageError, match="candidate has shape"):
        snr_sums(p[..., :1], r1, r2)
    p[0, 0, 0] = np.nan
    assert np.isnan(snr_db(p, r1, r2))


def test_flicker_by_hand() -> None:
    """Two steps: the candidate changes by 2 and 1, the reference by 1 and 1; the changes differ by 1 and 0."""
    candidate, reference = np.array([[0.0], [2.0], [3.0]]), np.array([[5.0], [6.0], [7.0]])
    assert flicker_ratio(candidate, reference, reference) == pytest.approx((4 + 1) / (1 + 1))
    assert flicker_snr_db(candidate, reference, reference) == pytest.approx(10 * np.log10(2 / 1))


def test_reference_noise_does_not_bias_flicker() -> None:
    rng = np.random.default_rng(0)
    frames = rng.random((2, 40_000, 3))
    noisy = [frames + 0.3 * rng.standard_normal(frames.shape) for _ in range(2)]
    assert flicker_ratio(frames, *noisy) == pytest.approx(1, abs=0.03)
    assert flicker_ratio(frames, noisy[0], noisy[0]) < 0.6


def test_change_below_the_noise_is_no_figure() -> None:
    rng = np.random.default_rng(0)
    still = np.broadcast_to(rng.random((40_000, 3)), (2, 40_000, 3))
    noisy = [still + 0.3 * rng.standard_normal(still.shape) for _ in range(2)]
    assert np.isnan(flicker_ratio(rng.random(still.shape), *noisy))
    assert np.isnan(flicker_ratio(still, still, still))


def test_a_change_of_a_twentieth_of_the_noise_is_the_least_that_is_a_figure() -> None:
    sums = np.array([[1.0, 0.049, 1.0], [1.0, 0.051, 1.0]])
    ratio = flicker_ratio_from_sums(sums)
    assert np.isnan(ratio[0]) and ratio[1] == pytest.approx(1 / 0.051)


def test_sums_of_flicker_by_pair() -> None:
    p, a, b = estimates(shape=(3, 8, 400, 3))
    sums = np.stack([flicker_sums(p[:, k], a[:, k], b[:, k]) for k in range(8)])
    assert sums.shape == (8, 3)
    assert sums.sum(0) == pytest.approx(flicker_sums(p, a, b))
    each = [flicker_ratio(p[:, k], a[:, k], b[:, k]) for k in range(8)]
    assert flicker_ratio_from_sums(sums) == pytest.approx(each)
    assert flicker_interval(sums).estimate == pytest.approx(flicker_ratio(p, a, b))


@pytest.mark.parametrize("measure", [flicker_ratio, flicker_snr_db])
def test_frames_that_do_not_fit(measure) -> None:
    frames = np.random.default_rng(0).random((3, 20, 3))
    with pytest.raises(UsageError, match="first has shape"):
        measure(frames, frames[:2], frames)
    with pytest.raises(UsageError, match="two frames or more"):
        measure(frames[:1], frames[:1], frames[:1])
    broken = frames.copy()
    broken[1, 2, 0] = np.nan
    with pytest.raises(UsageError, match="second has values that are not finite"):
        measure(frames, frames, broken)


def test_mean_intervals_cover_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(400):
        interval = mean_interval(3 + rng.standard_normal(64))
        assert interval.low <= interval.estimate <= interval.high
        hits += interval.low <= 3 <= interval.high
    assert 0.91 < hits / 400 < 0.98  # 0.95, three standard errors of 0.011 around what 64 values give


def test_a_gain_on_the_same_pairs_is_told_apart_where_the_figures_are_not() -> None:
    rng = np.random.default_rng(0)
    hard = 0.1 * rng.exponential(size=64) ** 2
    rows = [np.stack([np.ones(64), share * hard, np.zeros(64)], -1) for share in (0.8, 1.0)]
    better, worse = (snr_interval(r) for r in rows)
    gain = snr_gain_interval(*rows)
    assert better.low < worse.high
    assert gain.estimate == pytest.approx(10 * np.log10(1 / 0.8))
    assert 0 < gain.low <= gain.high == pytest.approx(gain.low, abs=1e-6)


def test_a_figure_that_some_resamples_lack_has_no_bounds() -> None:
    """Only one pair changes at all: a third of the resamples miss it."""
    sums = np.zeros((8, 3))
    sums[0] = 1, 2, 0
    interval = flicker_interval(sums)
    assert interval.estimate == 0.5 and np.isnan(interval.low) and np.isnan(interval.high)


def test_snr_of_a_known_error() -> None:
    reference = np.ones((4, 5, 3), np.float32)
    assert snr_db(reference * 1.1, reference, reference) == pytest.approx(20, abs=1e-4)
