"""The per-material optimum: better than its start where there is a prize, never worse, and only what it may change."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from mipbake import material
from mipbake.errors import UsageError
from mipbake.judging.held_out import HeldOut
from mipbake.metrics import PAIR_SETS, pair_set, snr_db
from mipbake.pixel_filter import level_sizes
from mipbake.prefilter.search import optimum, pixel_samples, texel_coordinates, texel_descent
from mipbake.prefilter.search.budget import Budget
from mipbake.prefilter.search.optimum import Optimum, Refined, Start, best_closed_form, refine
from mipbake.reference.estimate import estimate
from mipbake.reference.problem import Problem, Region
from mipbake.render import candidate, random_points, reference

WRAP = ("wrap", "wrap")
SMALL = Budget(rounds=16, points=96, held_out_pairs=256)
TINY = replace(SMALL, rounds=2, pairs=8, points=32, held_out_pairs=32)

CONSTANT = {
    "gltf": [0.2, 0.4, 0.6, 1, 0.35, 0.6, 0, 0.8],
    "gltf-anisotropic": [0.2, 0.4, 0.6, 0.5, 0.35, 0, -0.6, 0.8, 0.6, 0.8, 0.7],
    "ggx": [0.2, 0.4, 0.6, 0.1, 0.2, 0.3, 0.3, -0.2, -3, -5, 0.8],
}


def bumpy(height: int, width: int, roughness: float = 0.25) -> np.ndarray:
    rng = np.random.default_rng(1)
    normal = np.concatenate([0.25 * rng.standard_normal((height, width, 2)), np.ones((height, width, 1))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rest = np.broadcast_to(np.array([0.7, 0.5, 0.3, 1, roughness]), (height, width, 5))
    return np.concatenate([rest, normal], -1).astype(np.float32)


def problem(
    stored: np.ndarray, target: str = "gltf", kernel: str = "gaussian", wrap: tuple[str, str] = WRAP
) -> Problem:
    return Problem(stored, "gltf", target, kernel, wrap)


@pytest.fixture(scope="module")
def solved() -> tuple[Problem, Start, Refined]:
    task = problem(bumpy(32, 32))
    start = best_closed_form(task, SMALL)
    return task, start, refine(task, start, SMALL)


def test_bumpy_gloss_gains_at_every_level_on_pairs_it_never_saw(solved) -> None:
    task, start, result = solved
    for lod, name in itertools.product(range(6), PAIR_SETS):
        pairs, rng = pair_set(name, 17, 64), np.random.default_rng(lod)
        uv = random_points(rng, 256)
        first, second = (reference(task.stored, "gltf", WRAP, uv, lod, "gaussian", pairs, 128, rng) for _ in range(2))
        before, after = (
            snr_db(candidate(levels, "gltf", WRAP, uv, lod, pairs), first, second)
            for levels in (start.levels, result.levels)
        )
        assert after > before + 1, (lod, name)


def test_the_report_says_where_it_gained(solved) -> None:
    _, _, result = solved
    assert result.lods.tolist() == [lod / 2 for lod in range(11)]
    assert result.before.shape == result.after.shape == (len(PAIR_SETS), 11)
    assert (result.after > result.before).all()
    assert 0 < result.rounds <= SMALL.rounds
    assert all(0 <= share <= 1 for share in result.shares)


@pytest.mark.parametrize("model", CONSTANT)
def test_a_constant_material_is_left_alone(model: str) -> None:
    stored = np.broadcast_to(np.array(CONSTANT[model], np.float32), (8, 8, len(CONSTANT[model]))).copy()
    task = Problem(stored, model, model, "gaussian", WRAP)
    start = best_closed_form(task, TINY)
    result = refine(task, start, TINY)
    assert result.rounds == 0
    for one, other in zip(start.levels, result.levels, strict=True):
        assert np.array_equal(one, other)


def test_a_descent_that_went_wrong_is_not_kept(solved, monkeypatch: pytest.MonkeyPatch) -> None:
    task, start, _ = solved

    def spoil(_problem, levels, *_arguments) -> texel_descent.Descended:
        levels[0][..., 4] = 1
        levels[2][..., 0:3] = 0
        return texel_descent.Descended(1, np.zeros(6))

    monkeypatch.setattr(texel_descent, "descend", spoil)
    result = refine(task, start, TINY)
    for one, other in zip(start.levels, result.levels, strict=True):
        assert np.array_equal(one, other)
    assert result.after == pytest.approx(result.before)


def test_steps_that_are_far_too_long_do_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    task = problem(bumpy(8, 8))
    start = best_closed_form(task, TINY)
    monkeypatch.setattr(texel_coordinates, "_UNITS", {"gltf": (5.0,) * 7})
    result = refine(task, start, replace(SMALL, rounds=2))
    assert (result.after > result.before - 0.25).all()


def test_results_hang_on_the_seed_alone() -> None:
    task = problem(bumpy(8, 8))
    start = best_closed_form(task, TINY)
    kept = [level.copy() for level in start.levels]
    one, again, other = (refine(task, start, TINY, seed) for seed in (0, 0, 1))
    assert all(np.array_equal(a, b) for a, b in zip(one.levels, again.levels, strict=True))
    assert any(not np.array_equal(a, b) for a, b in zip(one.levels, other.levels, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(start.levels, kept, strict=True))


@pytest.mark.parametrize("target", CONSTANT)
@pytest.mark.parametrize("kernel", ["gaussian", "mitchell"])
def test_what_comes_out_is_a_valid_stack(target: str, kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mirrors, black and white metals and dielectrics, and steep normals; with everything kept, however bad."""
    stored = bumpy(6, 5)
    rng = np.random.default_rng(2)
    stored[..., 0:5] = rng.integers(0, 2, (6, 5, 5))
    stored[0, :, 5:8] = 1, 0, 0
    monkeypatch.setattr(optimum, "_shares", lambda judge, start, end, model: [1.0] * len(end))
    stages: list[float] = []
    task = problem(stored, target, kernel, ("clamp", "wrap"))
    result = Optimum(TINY)(stored, "gltf", target, kernel, task.wrap, stages.append)
    assert stages == sorted(stages) and stages[-1] == 1
    assert [level.shape[:2] for level in result.levels] == level_sizes(6, 5)
    low, high = np.array(material.MODELS[target].limits).T
    for level in result.levels:
        assert level.dtype == np.float32
        assert np.isfinite(level).all() and (level >= low).all() and (level <= high).all()
        for group in material.MODELS[target].unit_vectors:
            assert np.linalg.norm(level[..., group], axis=-1) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("model", CONSTANT)
def test_coordinates_go_back_to_what_they_came_from(model: str) -> None:
    stored = torch.tensor([CONSTANT[model]], dtype=torch.float64)
    coordinates = texel_coordinates.to_coordinates(stored, model)
    assert texel_coordinates.to_stored(coordinates, model) == pytest.approx(stored, abs=1e-6)
    far = coordinates + 50 * torch.randn(64, coordinates.shape[-1], generator=torch.Generator().manual_seed(0))
    out = texel_coordinates.to_stored(far, model).numpy()
    assert out == pytest.approx(material.regularise(out, model), abs=1e-4)


@pytest.mark.parametrize("wrap", [("wrap", "wrap"), ("clamp", "wrap"), ("clamp", "clamp")])
@pytest.mark.parametrize("size", [(40, 24), (33, 17)])
def test_windows_cover_every_texel_once_and_see_their_neighbours(wrap, size) -> None:
    levels = [bumpy(*s) for s in level_sizes(*size)]
    task = problem(levels[0], wrap=wrap)
    blocks = optimum._blocks(task, 8)
    counts = [np.zeros(level.shape[:2], int) for level in levels]
    rng = np.random.default_rng(0)
    for block in blocks:
        for index in block.levels:
            part = texel_coordinates.Crop(levels[index], block, "gltf", wrap, True)
            counts[index][part.window] += 1
            uv = part.pixels(1, rng)
            whole = texel_coordinates.Crop(levels[index], Region(0, 1, 0, 1, range(1)), "gltf", wrap, False)
            inside = (uv >= block.origin).all(1) & (uv <= block.origin + block.extent).all(1)
            assert inside.any()
            assert part.look_up(uv[inside]) == pytest.approx(whole.look_up(uv[inside]), abs=1e-4)
    assert all((count == 1).all() for count in counts)


def test_a_block_changes_its_own_texels_alone() -> None:
    task = problem(bumpy(32, 32))
    start = best_closed_form(task, TINY)
    levels = [level.copy() for level in start.levels]
    block = optimum._blocks(task, 16)[1]
    rng = np.random.default_rng(0)
    lobes = [pixel_samples.Lobes(each) for each in optimum.lobes_under(task)]
    texel_descent.descend(task, levels, block, [True] * 6, lobes, start.ahead, SMALL, rng, np.inf, lambda _: None)
    changed = [(a != b).any(-1) for a, b in zip(start.levels, levels, strict=True)]
    assert changed[0][:16, :16].mean() > 0.9
    assert not changed[0][16:].any() and not changed[0][:, 16:].any()
    assert not any(c.any() for c in changed[1:])


def test_large_sets_are_worked_on_in_windows() -> None:
    task = problem(bumpy(16, 16))
    start = best_closed_form(task, TINY)
    result = refine(task, start, replace(SMALL, window=8))
    assert result.rounds > 2
    assert (result.after.mean(1) > result.before.mean(1) + 1).all()


@pytest.mark.parametrize("kernel", ["gaussian", "mitchell"])
def test_quick_estimates_are_the_reference(kernel: str) -> None:
    task = problem(bumpy(16, 12), kernel=kernel, wrap=("clamp", "wrap"))
    pairs, rng = pair_set("hemisphere", 3, 8), np.random.default_rng(0)
    uv = random_points(rng, 40)
    for lod in (0.0, 1.5):
        quick, other = (estimate(task, uv, lod, pairs, 2048, rng) for _ in range(2))
        exact, again = (reference(task.stored, "gltf", task.wrap, uv, lod, kernel, pairs, 2048, rng) for _ in range(2))
        noise = (np.square(exact - again).mean() + np.square(quick - other).mean()) / 2
        assert np.square(quick - exact).mean() < 2 * noise
        assert np.sqrt(noise) < 0.3 * exact.mean()


def test_time_ends_it() -> None:
    task = problem(bumpy(8, 8))
    result = refine(task, best_closed_form(task, TINY), replace(SMALL, rounds=1000, seconds=0.01))
    assert result.rounds <= 2


def test_bad_arguments_say_what_was_expected() -> None:
    task = problem(bumpy(8, 8))
    start = best_closed_form(task, TINY)
    with pytest.raises(UsageError, match=r"start has levels of shapes .*: expected .*every level of gltf"):
        refine(task, start.levels[:-1], TINY)
    broken = [level.copy() for level in start.levels]
    broken[1][0, 0, 0] = np.nan
    with pytest.raises(UsageError, match="start holds values that are not finite"):
        refine(task, broken, TINY)
    with pytest.raises(UsageError, match="unknown pixel filter 'sinc'"):
        refine(replace(task, pixel_filter="sinc"), start, TINY)
    for name, value in {
        "rounds": -1,
        "steps": 0,
        "pairs": 6,
        "samples": 0,
        "window": 4,
        "seconds": 0,
    }.items():
        with pytest.raises(UsageError, match=f"{name} of the budget is"):
            replace(TINY, **{name: value})


def test_held_out_pairs_are_not_those_that_figures_are_quoted_for() -> None:
    task = problem(bumpy(4, 4))
    judge = HeldOut(task, Region(0, 1, 0, 1, range(1)), TINY.held_out, [0, 2])
    for seed in range(4):
        for name in PAIR_SETS:
            quoted = pair_set(name, seed).view
            assert np.abs(judge.pairs.view[:, None] - quoted).max(-1).min() > 1e-6
