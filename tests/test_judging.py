"""How stacks are judged: terms and weights, renders and scores, bright pairs, and samplers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mipbake.material.aim import TRILINEAR, Sampler
from mipbake.quality.figures import Candidate, Method
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.pairs import KINDS, draw_pairs, draw_pool
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Errors, Score, Scores
from mipbake.quality.judging.shown import KINDS_SHOWN
from mipbake.quality.judging.terms import PICTURES, TERMS, Weights, certainty, weights_for
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.metrics.visible import mean_squares
from mipbake.quality.reference.estimate import bilinear, estimate
from mipbake.quality.reference.lighting import GroupPairs
from mipbake.quality.reference.problem import Problem, covered
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.samplers import jitter
from mipbake.quality.texture_space import MeasureEffort, measure
from mipbake.shading import shade

from .search_cases import TINY, WRAP, bumpy
from .test_compare_candidates import noisy

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


def test_what_chance_decides_counts_little() -> None:
    rows = np.stack([np.full(9, -2.0), np.full(9, -2.0) + np.tile([-1.05, 0, 1.05], 3), 20.0 * np.arange(9)])
    known, unsure, chance = certainty(rows)
    assert known == 1 and 0.3 < unsure < 0.7 and chance < 0.01
    baseline = Baseline.of(Score(np.zeros((2, 4)), rows[[0, 1, 2, 2]], np.zeros((len(PICTURES), 4))))
    assert baseline.certainties.tolist() == [1, 1, known, unsure, chance, chance, 1, 1]  # pictures last


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


@pytest.mark.parametrize("kernel", ["gaussian", "mitchell"])
def test_scores_of_the_source_itself_are_right_where_it_is_constant(kernel: str) -> None:
    stored = np.broadcast_to(np.array([0.2, 0.4, 0.6, 0.5, 0.4, 0, 0, 1], np.float32), (8, 8, 8)).copy()
    scores = Scores(Problem(stored, "gltf", "gltf", kernel, WRAP), TINY, 0, [0.0, 1.5])
    for index in range(2):
        errors = scores.errors(scores.looked_up(stored, index), index)
        assert (errors.score.decibels > 60).all()
        assert (mean_squares(errors.visible.off) < 2e-4).all()


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


MANY_SAMPLES = ProbeEffort(groups=2, points=16, samples=64, pictures=8, picture_samples=2)


def problem(sampler: Sampler) -> Problem:
    return Problem(bumpy(16, 16, 0.5), "gltf", "gltf", "gaussian", WRAP, sampler)


@pytest.mark.parametrize("bias", [-1.0, -0.3, 0.5])
def test_what_is_right_is_what_a_pixel_covers_without_the_bias(bias: float) -> None:
    task = problem(Sampler(bias=bias))
    (probe,) = Scores(task, MANY_SAMPLES, 0, [1.0]).probes
    assert probe.levels == (1,)
    right, other = (
        estimate(
            task.filtered, Pixels(probe.uv, lod), GroupPairs(probe.light, probe.view), 256, np.random.default_rng(1)
        )
        for lod in (1.0 - bias, 1.0)
    )
    off = [float(np.square(probe.mean - each).mean()) for each in (right, other)]
    assert off[0] < 0.3 * off[1], off


def test_level_0_is_looked_up_by_all_pixels_that_a_negative_bias_brings_there() -> None:
    lods, rng = np.array([0.0, 1.0]), np.random.default_rng(0)
    found = np.stack([covered(problem(Sampler(bias=-1.5)), lods, rng) for _ in range(50)])
    assert (found[:, 1] == 2.5).all() and 0 <= found[:, 0].min() < 0.2 and 1.3 < found[:, 0].max() <= 1.5
    assert (covered(problem(Sampler(bias=0.5)), lods, rng) == lods - 0.5).all()
    assert covered(problem(TRILINEAR), lods, rng) is lods


def test_the_judge_shades_every_frame_and_takes_their_mean() -> None:
    """Against a loop over the frames, each of which shows another point of the pixels."""
    task = problem(Sampler(bias=-0.5, frames=8))
    scores = Scores(task, MANY_SAMPLES, 0, [1.0])
    (probe,) = scores.probes
    level = bumpy(8, 8, 0.3)
    found = scores.errors(scores.looked_up(level, 0), 0)
    groups, count = probe.uv.shape[0], probe.mean.shape[2]
    shown = np.zeros_like(probe.mean)
    centre = probe.uv.reshape(groups, count, 8, 2)[:, :, 0] - jitter(8)[0] * 2**1.5 / 16
    for offset in jitter(8):
        texels = bilinear(level, centre + offset * 2**1.5 / 16, WRAP)
        shown += shade("gltf", texels, probe.light, probe.view) / 8
    expected = np.square(shown - probe.mean).mean((2, 3)) - probe.noise
    np.testing.assert_allclose(found.squares, expected, rtol=1e-3, atol=1e-6)


def test_a_bias_is_a_stack_whose_levels_are_shifted() -> None:
    """What is measured with bias -1 at a level of detail is what the finer level shows without a bias."""
    texture_set = noisy()
    levels = [bumpy(max(1, texture_set.height >> level), max(1, texture_set.width >> level)) for level in range(7)]
    levels = levels[: next(i for i, level in enumerate(levels) if level.shape[:2] == (1, 1)) + 1]
    method = Method("shown", "linear", "box", "gltf")
    effort = MeasureEffort(points=256, samples=4, intervals=False)

    def snr(stack: list[np.ndarray], sampler: Sampler) -> list[float]:
        given = texture_set.filtered("gaussian"), [Candidate(method, stack)], [2.0], (), effort
        return [figure.value for figure in measure(*given, sampler=sampler).curve]

    shifted = [levels[0], levels[0], levels[1], *levels[3:]]
    assert snr(levels, Sampler(bias=-1.0)) == pytest.approx(snr(shifted, TRILINEAR), rel=1e-6)
    frames = snr(levels, replace(TRILINEAR, frames=8))
    assert frames != pytest.approx(snr(levels, TRILINEAR), rel=1e-3) and np.isfinite(frames).all()
