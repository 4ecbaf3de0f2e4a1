"""What can be chosen for a method beside its name: weights, the time it may take, a sampler, an aim and a device."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake.baking.bake import Recipe
from mipbake.baking.methods import METHODS, OPTIONS, method_named
from mipbake.baking.neural import Neural
from mipbake.baking.search.long_run import seconds_of
from mipbake.baking.search.methods import REFINE_SECONDS, Auto, Optimum, Refine, Searching
from mipbake.baking.search.stages import Descend
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.base.errors import UsageError
from mipbake.material import MODELS, convert
from mipbake.material.aim import ANISOTROPIC, Sampler
from mipbake.material.pixel_filter import FILTERS
from mipbake.models import list_weights
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.stack.presets import PRESETS

from . import packed_sets


def test_budgets_are_seconds_minutes_hours_or_best() -> None:
    assert [seconds_of(text) for text in ("30s", "2m", " 1.5 m ", "0.5s", "90S")] == [30, 120, 90, 0.5, 90]
    assert [seconds_of(text) for text in ("2h", "1.5 H")] == [7200, 5400]
    assert seconds_of("best") is None


@pytest.mark.parametrize("text", ["", "30", "0s", "-1m", "2d", "soon", "s", "nan s", "1e3s"])
def test_other_budgets_say_what_is_expected(text: str) -> None:
    with pytest.raises(
        UsageError, match=r"a time above 0 in seconds, minutes or hours, for example 30s, 2m or 1h, or best"
    ):
        seconds_of(text)


@pytest.mark.parametrize("option", OPTIONS)
def test_methods_without_an_option_refuse_it(option: str) -> None:
    values = {
        "weights": list_weights()[0].name,
        "budget": "1s",
        "sampler": "anisotropic",
        "aim": 1.0,
        "device": "cpu",
    }
    value = values[option]
    for name in METHODS:
        if name in OPTIONS[option]:
            assert method_named(name, **{option: value}).name == name
        else:
            with pytest.raises(UsageError, match=rf"method {name} takes no {option}: .*{'.*'.join(OPTIONS[option])}"):
                method_named(name, **{option: value})


def test_several_options_are_taken_at_once() -> None:
    found = method_named("auto", budget="2s", sampler="anisotropic", aim=0.0)
    assert isinstance(found, Auto) and (found.seconds, found.sampler, found.aim) == (2, ANISOTROPIC, 0)
    with pytest.raises(UsageError, match=r"method optimum takes no aim: leave it out, or choose one of auto, refine"):
        method_named("optimum", budget="2s", aim=0.0)


def test_a_preset_chooses_for_a_call_as_it_does_for_a_command(tmp_path: Path) -> None:
    chosen = Recipe(preset="unreal").resolved()
    assert (chosen.sampler, chosen.target) == (PRESETS["unreal"].sampler, "gltf")
    assert Recipe(preset="unreal", sampler="trilinear", lod_bias=-1).resolved().sampler == Sampler(bias=-1)
    assert Recipe("lean", preset="unreal").resolved().sampler is None  # it takes none
    folder = packed_sets.orm(tmp_path / "wood")
    stack = mipbake.bake(folder, "linear", preset="unreal")
    assert stack.provenance == mipbake.bake(mipbake.load(folder), "linear", "gltf").provenance
    with pytest.raises(UsageError, match="unknown option 'samplers': expected one of method, target"):
        mipbake.bake(folder, samplers="trilinear")


def test_a_recipe_for_another_method_leaves_out_what_that_does_not_take() -> None:
    recipe = Recipe(target="gltf", sampler="anisotropic", aim=0.0, device="cpu")
    assert recipe.by("neural", "box") == replace(recipe, method="neural", pixel_filter="box", aim=None)
    assert recipe.by("linear", "box") == Recipe("linear", "gltf", "box")


def test_samplers_and_aims_that_no_stack_is_made_for_are_refused() -> None:
    for name in OPTIONS["sampler"]:
        with pytest.raises(UsageError, match=r"'stochastic': expected trilinear, anisotropic or accumulated"):
            method_named(name, sampler="stochastic")
    for aim in (-0.1, 1.5, float("nan")):
        with pytest.raises(UsageError, match=r"expected a number from 0 .* to 1"):
            method_named("refine", aim=aim)


def test_results_say_what_they_were_made_for() -> None:
    stored = np.full((4, 4, 8), [0.5, 0.4, 0.3, 1, 0.4, 0, 0, 1], np.float32)
    effort = ProbeEffort(groups=4, points=8, samples=2, pictures=8, doublings=0)
    made = {
        each.name: each(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap"), lambda _: None)
        for each in (
            Auto(effort=effort, descent=DescentEffort(rounds=1, looks=effort), sampler=ANISOTROPIC, aim=0.25),
            Neural(sampler=ANISOTROPIC),
            Optimum(effort=effort, descent=DescentEffort(rounds=1, looks=effort)),
            METHODS["lean"],
        )
    }
    assert {name: (each.sampler, each.aim) for name, each in made.items()} == {
        "auto": (ANISOTROPIC, 0.25),
        "neural": (ANISOTROPIC, None),
        "optimum": (None, None),
        "lean": (None, None),
    }


def test_weights_are_found_before_anything_is_baked() -> None:
    with pytest.raises(UsageError, match="unknown weights 'none-such': expected one of"):
        method_named("neural", weights="none-such")


def test_weights_of_another_model_are_refused() -> None:
    info = next(info for info in list_weights() if "ggx" in info.targets and "gltf" not in info.targets)
    stored = np.full((4, 4, 8), 0.5, np.float32)
    with pytest.raises(UsageError, match=rf"weights {info.name} are for material model .* expected some for gltf"):
        method_named("neural", weights=info.name)(stored, "gltf", "gltf", "gaussian", ("wrap", "wrap"), lambda _: None)


def test_named_weights_are_used() -> None:
    info = next(info for info in list_weights() if info.targets == ("gltf",))
    stored = np.full((4, 4, 8), 0.5, np.float32)
    stored[..., 5:] = 0, 0, 1
    result = method_named("neural", weights=info.name)(
        stored, "gltf", "gltf", info.pixel_filters[0], ("wrap", "wrap"), lambda _: None
    )
    assert (result.weights, result.weights_sha256) == (info.name, info.sha256)


@pytest.mark.parametrize("name", ["refine", "optimum", "auto"])
def test_budgets_are_seconds(name: str) -> None:
    found = [method_named(name, budget=budget) for budget in ("1.5m", "2s", "best")]
    assert [method.seconds for method in found if isinstance(method, Searching)] == [90, 2, None]
    refine, others = METHODS["refine"], [METHODS[each] for each in ("auto", "optimum")]
    assert isinstance(refine, Searching) and refine.seconds == REFINE_SECONDS
    assert all(isinstance(each, Searching) and each.seconds is None for each in others)


@pytest.mark.parametrize("budget", [None, "30s", "best"])
@pytest.mark.parametrize("kind", [Auto, Refine, Optimum])
def test_a_descent_makes_the_effort_that_was_given_with_a_budget_too(kind: type[Searching], budget: str | None) -> None:
    given = DescentEffort(rounds=3)
    found = [step.stage for step in kind(budget=budget, descent=given).steps]
    assert [stage.effort for stage in found if isinstance(stage, Descend)] == [given]


def test_auto_with_a_budget_refines() -> None:
    assert list(Auto(budget="30s").steps) == list(Refine(budget="30s").steps)


@pytest.mark.parametrize("source", MODELS)
@pytest.mark.parametrize("target", MODELS)
def test_weights_that_are_found_bake(source: str, target: str) -> None:
    """Every target has weights under every filter that nobody has to name, whatever the source is in."""
    stored = convert(np.full((4, 4, 8), [0.5, 0.4, 0.3, 1, 0.4, 0, 0, 1], np.float32), "gltf", source)
    neural = Neural()
    for pixel_filter in FILTERS:
        assert target in neural.weights(target, pixel_filter, source).targets
        levels = neural(stored, source, target, pixel_filter, ("wrap", "wrap"), lambda _: None).levels
        assert all(np.isfinite(level).all() for level in levels)


def test_named_weights_that_lose_what_a_source_says_are_refused() -> None:
    with pytest.raises(UsageError, match="mipbake-3-anisotropic read gltf"):
        Neural("mipbake-3-anisotropic").weights("gltf-anisotropic", "gaussian", "gltf-anisotropic")
