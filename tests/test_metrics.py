"""Pair sets and SNR."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.quality.metrics import PAIR_SETS, pair_set, snr_db
from mipbake.quality.metrics.snr import MAX_SNR_DB


@pytest.mark.parametrize("name", PAIR_SETS)
def test_pairs_are_unit_above_the_horizon_and_fixed_by_the_seed(name: str) -> None:
    pairs = pair_set(name, 5)
    for directions in (pairs.light, pairs.view):
        assert directions.shape == (1024, 3)
        assert np.linalg.norm(directions, axis=-1) == pytest.approx(1, abs=1e-6)
        assert directions[:, 2].min() > 0
    assert (pair_set(name, 5).light == pairs.light).all()
    assert not np.allclose(pair_set(name, 6).light, pairs.light)


def test_views_are_cosine_distributed() -> None:
    """The mean of cos(theta) under cos(theta) / pi is 2/3; of its square, 1/2."""
    z = pair_set("hemisphere", 0, 200_000).view[:, 2].astype(float)
    assert z.mean() == pytest.approx(2 / 3, abs=3e-3)
    assert (z * z).mean() == pytest.approx(1 / 2, abs=3e-3)


def test_near_mirror_lights_spread_around_the_mirror_direction() -> None:
    pairs = pair_set("near-mirror", 0, 100_000)
    steep = pairs.view[:, 2] > 0.7  # far from the horizon, where nothing is redrawn
    mirror = pairs.view[steep] * [-1, -1, 1]
    angle = np.arccos(np.clip((pairs.light[steep] * mirror).sum(-1), -1, 1))
    # Two of the Gaussian's three components turn the direction: a Rayleigh distribution of scale 0.12.
    assert angle.mean() == pytest.approx(0.12 * np.sqrt(np.pi / 2), rel=0.02)


def test_snr_of_a_known_error() -> None:
    reference = np.ones((4, 5, 3), np.float32)
    assert snr_db(reference * 1.1, reference, reference) == pytest.approx(20, abs=1e-4)


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


def test_lights_are_stratified_and_independent_of_views() -> None:
    pairs = pair_set("hemisphere", 3)
    light = np.sort(1 - np.square(pairs.light[:, 2].astype(float)))
    assert np.abs(light - (np.arange(1024) + 0.5) / 1024).max() < 1 / 32
    assert abs(np.corrcoef(pairs.light[:, 2], pairs.view[:, 2])[0, 1]) < 0.1


def test_unknown_pair_set_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match="near-mirror, hemisphere"):
        pair_set("everywhere", 0)
