"""Pairs that judges draw: the bright ones stand for the pair sets that they come from."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.quality.judging.pairs import KINDS, draw_pairs, draw_pool
from mipbake.quality.metrics import PAIR_SETS


def test_bright_pairs_stand_for_the_sets_that_they_come_from() -> None:
    rng, count = np.random.default_rng(0), 100_000
    plain = draw_pairs(rng, count)

    def seen(light: np.ndarray, view: np.ndarray) -> np.ndarray:
        half = (light + view)[:, 2] / np.linalg.norm(light + view, axis=1)
        return np.stack([np.ones(len(half)), light[:, 2], view[:, 2], half > 0.998, light[:, 0] * view[:, 0]], 1)

    for kind in range(KINDS):
        pairs, weights = draw_pool(rng, count, kind)
        for index in range(len(PAIR_SETS)):
            some = slice(index * count, (index + 1) * count)
            height = plain.view[some, 2]
            inside = [(height > 0.03) & (height < 0.1), height > 0.1][kind] if index == 0 else height > 0.03
            values = seen(plain.light[some], plain.view[some])
            values = values[inside] if index == 0 else values * inside[:, None]
            drawn = seen(pairs.light[some], pairs.view[some])
            weight = weights[index][:, None]
            found = (weight * drawn).sum(0)
            # Weights of the first set sum to 1, weights of the second one to the share of what is inside.
            spread = weight * (drawn - found) if index == 0 else weight * drawn - found / count
            error = np.sqrt(values.var(0) / len(values) + np.square(spread).sum(0))
            # Whatever the seed, the weights of the second kind near the mirror sum to 0.9968.
            assert (np.abs(found - values.mean(0)) < 4 * error + 0.0035).all(), (kind, index)


def test_weights_of_pairs_over_the_hemisphere_sum_to_the_share_of_what_is_inside_however_few_there_are() -> None:
    rng, each, times = np.random.default_rng(0), 64, 2000
    row = list(PAIR_SETS).index("hemisphere")
    sums = [draw_pool(rng, each, 1)[1][row].sum() for _ in range(times)]
    # 0.9991 of all views do not graze beyond the range: cosines above 0.03.
    assert np.mean(sums) == pytest.approx(1 - 0.03**2, abs=4 * np.std(sums) / np.sqrt(times))
