"""The per-material optimum: better than its start where there is a prize, never worse, and only what it may change.

Seeds are fixed. Beside each limit of a figure that hangs on chance stands what 8 other seeds gave, of the method and of
the pairs and points that measure: the limit is the mean less four standard deviations.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mipbake import material
from mipbake.baking.methods import method_named
from mipbake.baking.search import crops, picture_samples, texel_coordinates, texel_descent
from mipbake.baking.search.blending import best
from mipbake.baking.search.ingredients import closed_forms
from mipbake.baking.search.methods import Optimum
from mipbake.baking.search.regions import timed_regions
from mipbake.baking.search.stages import Clock, Descend, Gather, Keep, Make, Search, Stage, Work
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.base.errors import UsageError
from mipbake.material.aim import ANISOTROPIC, TRILINEAR, Sampler
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.judging.terms import PICTURES, TERMS, Weight
from mipbake.quality.judging.weights import SINGLE_LIGHTS, Weights, weights_for
from mipbake.quality.metrics import PAIR_SETS, pair_set, snr_db
from mipbake.quality.reference.estimate import bilinear, reference
from mipbake.quality.reference.problem import Problem, Region, whole
from mipbake.quality.reference.sequences import random_points
from mipbake.quality.round_lookups import candidate

from .stacks import constant

WRAP = ("wrap", "wrap")
KINDS = [TRILINEAR, ANISOTROPIC, Sampler(4, -0.5, 8)]
SMALL = DescentEffort(rounds=16, looks=ProbeEffort(groups=4, points=48, pictures=8))
TINY = replace(SMALL, rounds=2, pairs=8, looks=ProbeEffort(groups=2, points=16, pictures=8, picture_samples=2))
EFFORT = ProbeEffort(groups=8, points=48, samples=8, pictures=16, picture_samples=4)


SEEN_ALONE = Weights({name: Weight(float(name in PICTURES), 0.0) for name in TERMS}, group_behind=0.0)


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


def searched(task: Problem, *stages: Stage, seed: int = 0) -> Search:
    """What stages make of a problem."""
    work = Work(task, list(closed_forms(task)), seed, Clock(0.0, math.inf), lambda _: None, SINGLE_LIGHTS)
    search = Search(work)
    for stage in stages:
        search = stage(search, lambda _: None)
    return search


def stages(effort: DescentEffort, *others: Stage, **settings: int) -> list[Stage]:
    """The stages of the method, other ones in place of the last where they are given."""
    return [Gather(EFFORT), Make(best), Descend(effort, True, 0.0, **settings), *(others or (Keep(),))]


def changing(change: Callable[[Search], list[np.ndarray]]) -> Stage:
    """A stage that only changes levels."""
    return lambda search, _progress: replace(search, levels=change(search))


@pytest.fixture(scope="module")
def solved() -> Search:
    return searched(problem(bumpy(32, 32)), *stages(SMALL))


@pytest.mark.long
def test_bumpy_gloss_gains_at_every_level_on_pairs_it_never_saw(solved: Search) -> None:
    task, gains = solved.work.problem, []
    for lod, name in itertools.product(range(6), PAIR_SETS):
        pairs, rng = pair_set(name, 17, 256), np.random.default_rng(lod)
        uv = random_points(rng, 256)
        first, second = (reference(task.filtered, uv, lod, pairs, 32, rng) for _ in range(2))
        before, after = (
            snr_db(candidate(levels, "gltf", WRAP, uv, lod, pairs), first, second)
            for levels in (solved.blend.levels, solved.levels)
        )
        gains.append(after - before)
    assert min(gains) > 0.58, gains  # mean 1.98, standard deviation 0.35
    assert np.mean(gains) > 3.3, gains  # mean 5.17, standard deviation 0.46


@pytest.mark.long
def test_single_lights_alone_count() -> None:
    """What people see, which other methods count, does not move the limit of single lights."""

    def levels(judged_by: Weights | None) -> list[np.ndarray]:
        method = Optimum(effort=EFFORT, descent=TINY, judged_by=judged_by)
        return method(bumpy(16, 16), "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels

    usual, single, other = (levels(weights) for weights in (None, SINGLE_LIGHTS, weights_for(0.5)))
    assert all((each.counts, each.behind) == (0, 0) for each in map(SINGLE_LIGHTS.terms.get, PICTURES))
    assert all(np.array_equal(mine, theirs) for mine, theirs in zip(usual, single, strict=True))
    assert not all(np.array_equal(mine, theirs) for mine, theirs in zip(usual, other, strict=True))


@pytest.mark.long
def test_what_was_kept_is_measured() -> None:
    shares: list[float] = []
    result = Optimum(effort=EFFORT, descent=TINY)(bumpy(16, 16), "gltf", "gltf", "gaussian", WRAP, shares.append)
    assert shares == sorted(shares) and shares[-1] == 1
    assert result.measured is not None and result.weights is None
    assert [each.level for each in result.measured.levels] == list(range(5))
    assert all(0 <= each.refined <= 1 and len(each.sources) == 1 for each in result.measured.levels)
    assert max(each.refined for each in result.measured.levels) > 0


@pytest.mark.parametrize("model", material.MODELS)
def test_a_constant_material_is_left_alone(model: str) -> None:
    stored = constant((8, 8), model)
    result = searched(Problem(stored, model, model, "gaussian", WRAP), *stages(TINY))
    for one, other in zip(result.blend.levels, result.levels, strict=True):
        assert np.array_equal(one, other)


def test_a_descent_that_went_wrong_is_not_kept(solved: Search) -> None:
    def spoilt(search: Search) -> list[np.ndarray]:
        levels = [level.copy() for level in search.blend.levels]
        levels[0][..., 4] = 1
        levels[2][..., 0:3] = 0
        return levels

    result = Keep()(changing(spoilt)(solved, lambda _: None), lambda _: None)
    for one, other in zip(solved.blend.levels, result.levels, strict=True):
        assert np.array_equal(one, other)
    assert not any(result.kept)


def test_steps_that_are_far_too_long_do_no_harm(solved: Search) -> None:
    def far(search: Search) -> list[np.ndarray]:
        both = zip(search.blend.levels, search.levels, strict=True)
        return [material.regularise(start + 6 * (end - start), "gltf") for start, end in both]

    result = Keep()(changing(far)(solved, lambda _: None), lambda _: None)
    for index, before in enumerate(solved.before):
        after = solved.blend.check.of_stack(result.levels)[index]
        assert (after.decibels > before.decibels - 0.01).all()  # 0 with each of the 8 seeds: where nothing is kept


@pytest.mark.long
def test_results_hang_on_the_seed_alone() -> None:
    task = problem(bumpy(8, 8))
    one, again, other = (searched(task, *stages(TINY), seed=seed).levels for seed in (0, 0, 1))
    assert all(np.array_equal(a, b) for a, b in zip(one, again, strict=True))
    assert any(not np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "kernel"), [*zip(material.MODELS, itertools.cycle(["gaussian", "mitchell"]), strict=False)]
)
def test_what_comes_out_is_a_valid_stack(target: str, kernel: str) -> None:
    """Mirrors, black and white metals and dielectrics, and steep normals; with everything kept, however bad."""
    stored = bumpy(6, 5)
    rng = np.random.default_rng(2)
    stored[..., 0:5] = rng.integers(0, 2, (6, 5, 5))
    stored[0, :, 5:8] = 1, 0, 0
    task = problem(stored, target, kernel, ("clamp", "wrap"))
    result = searched(task, *stages(TINY)[:-1])
    assert [level.shape[:2] for level in result.levels] == level_sizes(6, 5)
    low, high = np.array(material.MODELS[target].limits).T
    for level in result.levels:
        assert level.dtype == np.float32
        assert np.isfinite(level).all() and (level >= low).all() and (level <= high).all()
        for group in material.MODELS[target].unit_vectors:
            assert np.linalg.norm(level[..., group], axis=-1) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("model", material.MODELS)
def test_coordinates_go_back_to_what_they_came_from(model: str) -> None:
    stored = constant((1,), model).astype(float)
    coordinates = texel_coordinates.to_coordinates(stored, model)
    assert texel_coordinates.to_stored(coordinates, model) == pytest.approx(stored, abs=1e-6)
    far = coordinates + 50 * np.random.default_rng(0).standard_normal((64, coordinates.shape[-1]))
    out = texel_coordinates.to_stored(far, model)
    assert out == pytest.approx(material.regularise(out, model), abs=1e-4)


@pytest.mark.parametrize("wrap", [("wrap", "wrap"), ("clamp", "wrap"), ("clamp", "clamp")])
@pytest.mark.parametrize("size", [(40, 24), (33, 17)])
def test_windows_cover_every_texel_once_and_see_their_neighbours(wrap, size) -> None:
    levels = [bumpy(*s) for s in level_sizes(*size)]
    task = problem(levels[0], wrap=wrap)
    regions = [timed.region for timed in timed_regions(task, 8, fine=True, coarse=8)]
    counts = [np.zeros(level.shape[:2], int) for level in levels]
    rng = np.random.default_rng(0)
    for region in regions:
        for index in region.levels:
            part = crops.Crop(levels[index], region, task, True, 4)
            counts[index][part.window] += 1
            uv = part.pixels(1, rng)
            every = crops.Crop(levels[index], whole(task), task, False, 4)
            inside = (uv >= region.origin).all(1) & (uv <= region.origin + region.extent).all(1)
            assert inside.any()
            assert part.bilinear(uv[inside]) == pytest.approx(every.bilinear(uv[inside]), abs=1e-4)
    assert all((count == 1).all() for count in counts)


@pytest.mark.parametrize("sampler", KINDS)
def test_pictures_of_a_window_see_the_texels_around_it(sampler: Sampler) -> None:
    """Pictures are larger than windows may be, and what is looked up beside a window is looked up all the same."""
    task = replace(problem(bumpy(64, 64)), sampler=sampler)
    levels = [bumpy(*size) for size in task.sizes]
    rng = np.random.default_rng(0)
    for level in (0, 1):
        region = Region(0.5, 0.75, 0.25, 0.5, range(level, level + 1))
        for chunk in picture_samples.picture_chunks(task, region, level, 64, 1, rng):
            for index, _ in chunk.seen:
                around = picture_samples.texels_around(task, region, index)
                crop = crops.Crop(levels[index], region, task, True, around)
                np.testing.assert_allclose(crop.bilinear(chunk.uv), bilinear(levels[index], chunk.uv, WRAP), atol=2e-3)


@pytest.mark.long
@pytest.mark.parametrize("sampler", KINDS)
def test_what_is_seen_alone_moves_texels_to_what_looks_right(sampler: Sampler) -> None:
    """Where nothing else counts, renders that no round saw look better than those of the start."""
    task = replace(problem(bumpy(16, 16)), sampler=sampler)
    start = list(method_named("linear")(task.stored, "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels)
    start[0] = start[0] + np.float32([0, 0, 0, 0, 0.5, 0, 0, 0])  # far too rough
    levels = [level.copy() for level in start]
    descent = texel_descent.Descent(task, [True] * 5, replace(TINY, rounds=6), judged_by=SEEN_ALONE)
    texel_descent.descend(descent, levels, whole(task), np.random.default_rng(0))
    scores = Scores(task, replace(EFFORT, groups=2, points=4, pictures=64), 3, [0.0, 1.0, 2.0])
    before, after = (np.mean([each.visible for each in scores.of_stack(stack)]) for stack in (start, levels))
    assert after < before - 0.03, (before, after)  # 0.07 to 0.10 less with each of 4 seeds


@pytest.mark.long
def test_a_region_changes_its_own_texels_alone() -> None:
    task = problem(bumpy(32, 32))
    start = searched(task, *stages(TINY)[:2]).levels
    levels = [level.copy() for level in start]
    region = Region(0, 0.5, 0, 0.5, range(1))
    texel_descent.descend(texel_descent.Descent(task, [True] * 6, SMALL), levels, region, np.random.default_rng(0))
    changed = [(a != b).any(-1) for a, b in zip(start, levels, strict=True)]
    assert changed[0][:16, :16].mean() > 0.9
    assert not changed[0][16:].any() and not changed[0][:, 16:].any()
    assert not any(c.any() for c in changed[1:])


@pytest.mark.long
def test_large_sets_are_worked_on_in_windows() -> None:
    result = searched(problem(bumpy(16, 16)), *stages(replace(SMALL, window=8), coarse=4))
    after = result.blend.check.of_stack(result.levels)
    gains = [b.decibels.mean() - a.decibels.mean() for a, b in zip(result.before, after, strict=True)]
    assert min(gains) > 0.4, gains  # mean 1.50, standard deviation 0.27


def test_time_ends_it() -> None:
    task, effort = problem(bumpy(8, 8)), replace(SMALL, rounds=1000)
    levels = searched(task, *stages(TINY)[:2]).levels
    descent = texel_descent.Descent(task, [True] * 4, effort)
    deadline = time.monotonic() + 0.01
    assert texel_descent.descend(descent, levels, whole(task), np.random.default_rng(0), deadline)[0] <= 2


def test_bad_arguments_say_what_was_expected() -> None:
    with pytest.raises(UsageError, match="unknown pixel filter 'sinc'"):
        Optimum(effort=EFFORT, descent=TINY)(bumpy(8, 8), "gltf", "gltf", "sinc", WRAP, lambda _: None)
    for name, value in {"rounds": -1, "steps": 0, "pairs": 6, "samples": 0, "window": 4}.items():
        with pytest.raises(UsageError, match=f"DescentEffort was given {name}="):
            replace(TINY, **{name: value})


def test_pairs_that_judge_are_not_those_that_figures_are_quoted_for() -> None:
    (probe,) = Scores(problem(bumpy(4, 4)), EFFORT, 0, [0.0]).probes
    for seed in range(4):
        for name in PAIR_SETS:
            quoted = pair_set(name, seed).view
            assert np.abs(probe.view.reshape(-1, 1, 3) - quoted).max(-1).min() > 1e-6


def test_probes_of_a_region_lie_inside_it() -> None:
    region = Region(0.5, 1, 0, 0.25, range(1))
    (probe,) = Scores(problem(bumpy(16, 16)), EFFORT, 0, [0.0], region).probes
    centres = probe.shown.pictures.uv.mean(1)  # pictures are as large as they are
    for uv in (probe.uv.reshape(-1, 2), centres):
        assert (uv >= [0, 0.5]).all() and (uv <= [0.25, 1]).all()
