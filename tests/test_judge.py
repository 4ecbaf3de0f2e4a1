"""What a stack is worth: the one answer to which of two is better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Errors, Score, Scores
from mipbake.quality.judging.shown import KINDS_SHOWN
from mipbake.quality.judging.terms import PICTURES, TERMS, Weight
from mipbake.quality.judging.weights import Weights, weights_for
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.reference.problem import Problem

SETS, GROUP_COUNT, POOLED, SHOWN = len(PAIR_SETS), 12, 5, 4
WEIGHTS = weights_for(0.5)
KEPT = [name for name in TERMS if name not in PICTURES]
"""The terms of single lights."""


def score_of(seed: int, shift: float = 0.0) -> Score:
    rng = np.random.default_rng(seed)
    return Score(
        rng.normal(-3 + shift, 0.3, (SETS, GROUP_COUNT)),
        rng.normal(-2 + shift, 0.3, (2 * SETS, POOLED)),
        np.array([[-4.0], [-5.0]]) + np.linspace(-0.01, 0.01, SHOWN) + shift,
    )


def judge_of(score: Score, plain: bool = True, weights: Weights = WEIGHTS) -> Judge:
    return Judge([Baseline.of(score, score.log_errors if plain else None)], weights)


def test_every_term_has_a_weight_and_no_other_name_is_taken() -> None:
    with pytest.raises(AssertionError, match="expected the names near-mirror"):
        Weights({"near-mirror": Weight(1, 1)}, 0.0)
    assert tuple(WEIGHTS.terms) == tuple(TERMS)
    with pytest.raises(AttributeError):
        WEIGHTS.tie = 1.0  # type: ignore[misc]


def test_the_aim_moves_what_counts_from_single_lights_to_what_is_seen() -> None:
    aims = np.linspace(0, 1, 11)
    every = [weights_for(aim) for aim in aims]
    for name in KEPT:
        counts, behind = np.array([(each.terms[name].counts, each.terms[name].behind) for each in every]).T
        assert (np.diff(counts) < 0).all() and counts[0] == 1 and counts[-1] > 0
        # What is behind counts in full up to the middle; from there on it gives way, and never wholly.
        assert (behind[aims <= 0.5] == behind[0]).all() and (np.diff(behind[aims >= 0.5]) < 0).all() and behind[-1] > 0
    for name in PICTURES:
        counts, behind = np.array([(each.terms[name].counts, each.terms[name].behind) for each in every]).T
        assert (np.diff(counts) > 0).all() and counts[0] > 0
        assert (np.diff(behind) > 0).all() and behind[0] == 0
    assert (np.diff([each.group_behind for each in every]) < 0).all() and every[-1].group_behind == 0
    assert (np.diff([each.terms[KEPT[0]].tie for each in every]) > 0).all()


def test_whether_looks_pay_for_single_lights_hangs_on_the_aim() -> None:
    """Seen better by half a neper, and as much worse under single lights: no gain while these may not be behind."""
    start = score_of(0)
    looks = replace(score_of(0, 0.5), visible=start.visible - 0.5)
    gains = []
    for aim in (0.0, 0.5, 1.0):
        judge = judge_of(start, weights=weights_for(aim))
        gains.append(judge.value(start, 0) - judge.value(looks, 0))
    assert gains[0] < 0 and gains[1] < 0 < gains[2]


def test_every_row_of_a_score_is_read_by_a_term_and_by_one_alone() -> None:
    score = score_of(0)
    rows = [(name, row) for name in ("log_errors", "pooled", "visible") for row in range(len(getattr(score, name)))]
    assert [(term.array, term.row) for term in TERMS.values()] == rows
    assert len(PICTURES) == KINDS_SHOWN
    means = [getattr(score, name)[row].mean() for name, row in rows]
    np.testing.assert_array_equal(score.terms, means)
    behind = judge_of(score).behind(score_of(0, 0.2), 0)
    assert behind == pytest.approx([0.2 - each.tie for each in WEIGHTS.terms.values()])


def test_what_is_worse_everywhere_is_worth_less() -> None:
    judge = judge_of(score_of(0))
    values = [judge.value(score_of(0, shift), 0) for shift in (-0.5, -0.1, 0.0, 0.1, 0.5)]
    assert values == sorted(values)
    assert values[4] - values[2] > 3 * (values[2] - values[0])  # what is behind counts in addition
    assert judge.satisfied(score_of(0), 0) and not judge.satisfied(score_of(0, 0.1), 0)


def test_a_gain_elsewhere_does_not_pay_for_what_falls_behind() -> None:
    start = score_of(0)
    shifted = start.log_errors + np.array([[0.4], [-0.4]])
    assert judge_of(start).value(replace(start, log_errors=shifted), 0) > judge_of(start).value(start, 0)


def test_chance_is_no_reason_to_be_behind() -> None:
    """Half a standard error of the difference is allowed, and not of the rows, which go together."""
    start = score_of(0)
    rng = np.random.default_rng(2)
    scattered = rng.permutation(np.linspace(-1, 1, GROUP_COUNT)) + 0.1
    by_chance = replace(start, log_errors=start.log_errors + scattered)
    steadily = replace(start, log_errors=start.log_errors + 0.1)
    judge = judge_of(start, plain=False, weights=weights_for(0.0))
    assert judge.behind(by_chance, 0)[0] < 0 < judge.behind(steadily, 0)[0]


def test_slopes_are_derivatives_of_the_value() -> None:
    judge, score = judge_of(score_of(0)), score_of(3, 0.2)
    slopes = judge.slopes(score, 0)
    step = 1e-4
    for row in range(SETS):
        for group in (0, 7):
            ahead, back = (score.log_errors.copy() for _ in range(2))
            ahead[row, group] += step
            back[row, group] -= step
            found = [judge.value(replace(score, log_errors=each), 0) for each in (ahead, back)]
            expected = slopes.log_errors[row] / GROUP_COUNT + slopes.groups[row, group]
            # Chance, taken to be where the score is, changes the value by at most its share of a group.
            assert (found[0] - found[1]) / (2 * step) == pytest.approx(
                expected, abs=WEIGHTS.chance * WEIGHTS.behind[row] / GROUP_COUNT
            )
    for kind, slope in enumerate(slopes.visible):
        along = step * np.eye(len(PICTURES))[kind][:, None]
        ahead, back = (judge.value(replace(score, visible=score.visible + turn * along), 0) for turn in (1, -1))
        assert (ahead - back) / (2 * step) == pytest.approx(slope, rel=1e-6)


def test_slopes_by_energies_are_derivatives_of_the_score() -> None:
    stored = np.random.default_rng(0).uniform(0.2, 0.8, (16, 16, 8)).astype(np.float32)
    stored[..., 5:] = [0, 0, 1]
    effort = ProbeEffort(groups=4, points=16, samples=16, pictures=8, picture_samples=2)
    scores = Scores(Problem(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap")), effort, 0, [1.0])
    flat = np.broadcast_to(stored.mean((0, 1)), (8, 8, 8)).astype(np.float32)
    errors = scores.errors(scores.looked_up(flat, 0), 0)
    rng = np.random.default_rng(1)
    by_log, by_pooled = rng.normal(size=errors.score.log_errors.shape), rng.normal(size=2 * SETS)

    def hangs_on(squares: np.ndarray) -> float:
        score = Errors(errors.probe, squares, errors.visible).score
        return float((by_log * score.log_errors).sum() + by_pooled @ score.pooled.mean(1))

    along = errors.squares * rng.normal(size=errors.squares.shape)
    step = 1e-5
    found = (hangs_on(errors.squares + step * along) - hangs_on(errors.squares - step * along)) / (2 * step)
    by_energy = errors.slopes(by_log, by_pooled)
    expected = (by_energy * errors.probe.energies(along)).sum()
    assert found == pytest.approx(expected, rel=1e-4)


def test_no_error_of_a_group_makes_a_stack_better_by_growing() -> None:
    """A tilted patch of mirror in a mirror: few groups of bright pairs hit it, and one rules the others."""
    stored = np.zeros((32, 32, 8), np.float32)
    stored[..., :3], stored[..., 3], stored[..., 4], stored[..., 7] = 0.7, 1, 0.06, 1
    stored[8:16, 8:16, 5:] = [0.3, 0.1, np.sqrt(0.9)]
    effort = ProbeEffort(groups=16, points=16, samples=4, pictures=8, picture_samples=2)
    scores = Scores(Problem(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap")), effort, 0, [1.0])
    wide = stored[::2, ::2].copy()
    wide[..., 4] = 0.3
    errors = scores.errors(scores.looked_up(wide, 0), 0)
    judge = Judge([Baseline.of(errors.score)], WEIGHTS)
    before = judge.value(errors.score, 0)
    for group in range(len(errors.squares)):
        squares = errors.squares.copy()
        squares[group] = 2 * np.maximum(squares[group], 0)
        assert judge.value(Errors(errors.probe, squares, errors.visible).score, 0) > before - 1e-9
