"""What `auto` measures by: references, what chance does to them, and slanted pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mipbake.material.pixel_filter import slanted_axes
from mipbake.quality.judging.judge import Baseline
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Score, Scores
from mipbake.quality.judging.terms import PICTURES, certainty
from mipbake.quality.metrics.visible import mean_squares
from mipbake.quality.reference.problem import Problem

from .test_auto import TINY, WRAP


def test_what_chance_decides_counts_little() -> None:
    rows = np.stack([np.full(9, -2.0), np.full(9, -2.0) + np.tile([-1.05, 0, 1.05], 3), 20.0 * np.arange(9)])
    known, unsure, chance = certainty(rows)
    assert known == 1 and 0.3 < unsure < 0.7 and chance < 0.01
    baseline = Baseline.of(Score(np.zeros((2, 4)), rows[[0, 1, 2, 2]], np.zeros((len(PICTURES), 4))))
    assert baseline.certainties.tolist() == [
        1,
        1,
        known,
        unsure,
        chance,
        chance,
        1,
        1,
    ]  # pictures last


def test_noisy_references_take_more_samples() -> None:
    """Few texels of gloss in a rough, level surface: a handful of samples a pixel miss the highlights."""
    stored = np.zeros((32, 32, 8), np.float32)
    stored[..., 3], stored[..., 4], stored[..., 7] = 1, 0.8, 1
    stored[..., :3] = 0.5
    stored[::5, ::7, 4] = 0.3
    task = Problem(stored, "gltf", "gltf", "gaussian", WRAP)
    effort = ProbeEffort(groups=16, points=16, samples=2, pictures=8, picture_samples=2)

    def noise(doublings: int) -> float:
        (probe,) = Scores(task, replace(effort, doublings=doublings), 0, [3.0]).probes
        noise, signal = (probe.energies(each)[0, : probe.groups].sum() for each in (probe.noise, probe.signal))
        return float(noise / signal)

    more, less = noise(3), noise(0)
    assert more < 0.5 * less, (more, less)


def test_slanted_pixels_are_narrow_across_the_view() -> None:
    face_on, leaning, grazing = slanted_axes(np.array([[0, 0, 1], [0.8, 0, 0.6], [0, 1, 0]], np.float32))
    np.testing.assert_allclose(face_on, [[1, 0], [0, 1]])
    np.testing.assert_allclose(leaning, [[1, 0], [0, 0.6]], atol=1e-6)
    np.testing.assert_allclose(grazing, [[0, -1], [0.1, 0]], atol=1e-6)  # never a line
    assert face_on.dtype == np.float32
    (diagonal,) = slanted_axes(np.array([[0.48, 0.64, 0.6]], np.float32))
    # The view leans along +y, which is up in the image: v runs down.
    np.testing.assert_allclose(diagonal, [[0.6, -0.8], [0.48, 0.36]], atol=1e-6)


@pytest.mark.parametrize("kernel", ["gaussian", "mitchell"])
def test_scores_of_the_source_itself_are_right_where_it_is_constant(kernel: str) -> None:
    stored = np.broadcast_to(np.array([0.2, 0.4, 0.6, 0.5, 0.4, 0, 0, 1], np.float32), (8, 8, 8)).copy()
    scores = Scores(Problem(stored, "gltf", "gltf", kernel, WRAP), TINY, 0, [0.0, 1.5])
    for index in range(2):
        errors = scores.errors(scores.looked_up(stored, index), index)
        assert (errors.score.decibels > 60).all()
        assert (mean_squares(errors.visible.off) < 2e-4).all()
