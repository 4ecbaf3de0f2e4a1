"""The per-material optimum: better than its start where there is a prize, never worse, and only what it may change.

Limits of figures that hang on chance are given as in test_search.py.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from mipbake import material
from mipbake.baking.methods import METHODS, method_named
from mipbake.baking.search.blending import best
from mipbake.baking.search.ingredients import closed_forms
from mipbake.baking.search.methods import Optimum, Refine
from mipbake.baking.search.stages import Plan, Search
from mipbake.baking.search.texel_descent import Descent, DescentEffort, descend
from mipbake.base.errors import UsageError
from mipbake.material.aim import Sampler
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.judging.terms import PICTURES, SINGLE_LIGHTS, weights_for
from mipbake.quality.metrics import PAIR_SETS, pair_set, snr_db
from mipbake.quality.reference.estimate import reference
from mipbake.quality.reference.problem import Problem, Region, whole
from mipbake.quality.reference.sequences import random_points
from mipbake.quality.round_lookups import candidate

from .search_cases import EFFORT, SEEN_ALONE, TWO_ROUNDS, WRAP, bumpy
from .stacks import constant


def equal(first: list[np.ndarray], second: list[np.ndarray]) -> bool:
    return all(np.array_equal(one, other) for one, other in zip(first, second, strict=True))


def searched(task: Problem, descent: DescentEffort, keeps: bool = True, seed: int = 0) -> Search:
    """A search for the limit of single lights."""
    search, plan = Search(task, EFFORT, SINGLE_LIGHTS, seed), Plan(best, descent)
    search.begin(list(closed_forms(task)), plan)
    search.descend(plan)
    if keeps:
        search.keep()
    return search


@pytest.mark.long
def test_bumpy_gloss_gains_at_every_level_on_pairs_it_never_saw() -> None:
    task = Problem(bumpy(32, 32), "gltf", "gltf", "gaussian", WRAP)
    solved, gains = searched(task, DescentEffort(rounds=16, looks=ProbeEffort(groups=4, points=48, pictures=8))), []
    for lod, name in itertools.product(range(6), PAIR_SETS):
        pairs, rng = pair_set(name, 17, 256), np.random.default_rng(lod)
        uv = random_points(rng, 256)
        first, second = (reference(task.filtered, uv, lod, pairs, 32, rng) for _ in range(2))
        before, after = (
            snr_db(candidate(levels, "gltf", WRAP, uv, lod, pairs), first, second)
            for levels in (solved.start.levels, solved.levels)
        )
        gains.append(after - before)
    assert min(gains) > 0.58, gains  # mean 1.98, standard deviation 0.35
    assert np.mean(gains) > 3.3, gains  # mean 5.17, standard deviation 0.46


@pytest.mark.long
def test_single_lights_alone_count_and_results_hang_on_the_seed_alone() -> None:
    """What people see, which other methods count, does not move the limit of single lights."""

    def levels(**options: object) -> list[np.ndarray]:
        method = Optimum(effort=EFFORT, descent=TWO_ROUNDS, **options)
        return method(bumpy(8, 8), "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels

    usual = levels()
    assert all((each.counts, each.behind) == (0, 0) for each in map(SINGLE_LIGHTS.terms.get, PICTURES))
    assert equal(usual, levels(judged_by=SINGLE_LIGHTS))
    assert not equal(usual, levels(judged_by=weights_for(0.5))) and not equal(usual, levels(seed=1))


def test_what_was_kept_is_measured() -> None:
    shares: list[float] = []
    result = Optimum(effort=EFFORT, descent=TWO_ROUNDS)(bumpy(8, 8), "gltf", "gltf", "gaussian", WRAP, shares.append)
    assert shares == sorted(shares) and shares[-1] == 1
    assert result.measured is not None and result.weights is None
    assert [each.level for each in result.measured.levels] == list(range(4))
    assert all(0 <= each.refined <= 1 and len(each.sources) == 1 for each in result.measured.levels)
    assert max(each.refined for each in result.measured.levels) > 0


@pytest.mark.parametrize("model", material.MODELS)
def test_a_constant_material_is_left_alone(model: str) -> None:
    result = searched(Problem(constant((8, 8), model), model, model, "gaussian", WRAP), TWO_ROUNDS)
    assert equal(result.start.levels, result.levels)


def test_what_went_wrong_is_not_kept() -> None:
    """Neither levels that were spoilt, nor steps that are far too long, beyond what is taken for chance."""
    solved = searched(Problem(bumpy(16, 16), "gltf", "gltf", "gaussian", WRAP), TWO_ROUNDS, keeps=False)
    both = list(zip(solved.start.levels, solved.levels, strict=True))
    spoilt = [level.copy() for level in solved.start.levels]
    spoilt[0][..., 4], spoilt[2][..., 0:3] = 1, 0
    far = [material.regularise(start + 6 * (end - start), "gltf") for start, end in both]
    for solved.levels in (spoilt, far):
        solved.keep()
        for before, after in zip(solved.before, solved.start.check.of_stack(solved.levels), strict=True):
            assert (after.decibels > before.decibels - 0.2).all()
        if solved.levels is spoilt:
            assert not any(solved.kept)


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
    result = searched(Problem(stored, "gltf", target, kernel, ("clamp", "wrap")), TWO_ROUNDS, keeps=False)
    assert [level.shape[:2] for level in result.levels] == level_sizes(6, 5)
    low, high = np.array(material.MODELS[target].limits).T
    for level in result.levels:
        assert level.dtype == np.float32
        assert np.isfinite(level).all() and (level >= low).all() and (level <= high).all()
        for group in material.MODELS[target].unit_vectors:
            assert np.linalg.norm(level[..., group], axis=-1) == pytest.approx(1, abs=1e-5)


@pytest.mark.long
def test_pictures_alone_move_texels_to_what_looks_right() -> None:
    """Where nothing else counts, renders that no round saw look better than those of the start."""
    task = Problem(bumpy(16, 16), "gltf", "gltf", "gaussian", WRAP, Sampler(4, -0.5, 8))
    start = list(method_named("linear")(task.stored, "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels)
    start[0] = start[0] + np.float32([0, 0, 0, 0, 0.5, 0, 0, 0])  # far too rough
    levels = [level.copy() for level in start]
    descent = Descent(task, [True] * 5, replace(TWO_ROUNDS, rounds=6), judged_by=SEEN_ALONE)
    descend(descent, levels, whole(task), np.random.default_rng(0))
    scores = Scores(task, replace(EFFORT, groups=2, points=4, pictures=64), 3, [0.0, 1.0, 2.0])
    before, after = (np.mean([each.visible.mean(-1) for each in scores.of_stack(stack)]) for stack in (start, levels))
    assert after < before - 0.03, (before, after)  # 0.07 to 0.10 less with each of 4 seeds


def test_a_region_changes_its_own_texels_alone_until_time_ends_it() -> None:
    task = Problem(bumpy(32, 32), "gltf", "gltf", "gaussian", WRAP)
    start = METHODS["linear"](task.stored, "gltf", "gltf", "gaussian", WRAP, lambda _: None).levels
    levels, region = [level.copy() for level in start], Region(0, 0.5, 0, 0.5, range(1))
    descent = Descent(task, [True] * 6, replace(TWO_ROUNDS, rounds=1000))
    rounds, stopped = descend(descent, levels, region, np.random.default_rng(0), time.monotonic() + 0.01)
    assert rounds <= 2 and not stopped
    changed = [(a != b).any(-1) for a, b in zip(start, levels, strict=True)]
    assert changed[0][:16, :16].mean() > 0.9
    assert not changed[0][16:].any() and not changed[0][:, 16:].any()
    assert not any(c.any() for c in changed[1:])


def test_bad_arguments_say_what_was_expected() -> None:
    with pytest.raises(UsageError, match="unknown pixel filter 'sinc'"):
        Optimum()(bumpy(8, 8), "gltf", "gltf", "sinc", WRAP, lambda _: None)
    for name, value in {"rounds": -1, "steps": 0, "pairs": 6, "samples": 0, "window": 4}.items():
        with pytest.raises(UsageError, match=f"DescentEffort was given {name}="):
            replace(TWO_ROUNDS, **{name: value})


SCRIPT = """
import sys
sys.modules["torch"] = None  # importing it is an error from here on
from mipbake.baking.search import methods
from tests.search_cases import TINY, TWO_ROUNDS, WRAP, bumpy
method = type("Plain", (getattr(methods, sys.argv[1]),), {"learned": False})
method = method(budget="best", effort=TINY, descent=TWO_ROUNDS)
result = method(bumpy(16, 16), "gltf", "gltf-anisotropic", "gaussian", WRAP, lambda _: None)
assert any(level.refined for level in result.measured.levels)
print([name for name in sys.modules if name.split(".")[0] == "torch"])
"""


@pytest.mark.long
@pytest.mark.parametrize("method", [Refine, Optimum])
def test_a_search_without_a_network_imports_no_torch(method: type) -> None:
    """Its levels are optimised all the same."""
    command = [sys.executable, "-c", SCRIPT, method.__name__]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "['torch']"
