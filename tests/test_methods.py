"""All methods: what each promises, and what can be chosen for it beside its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake import material
from mipbake.baking.methods import METHODS, OPTIONS, method_named
from mipbake.baking.neural import Neural
from mipbake.baking.pipeline import Recipe
from mipbake.baking.search.long_run import seconds_of
from mipbake.baking.search.methods import REFINE_SECONDS, Auto, Optimum, Refine, Searching
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.base.errors import UsageError
from mipbake.material import MODELS, convert
from mipbake.material.aim import ANISOTROPIC, Sampler
from mipbake.material.pixel_filter import FILTERS, level_sizes
from mipbake.models import list_weights
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.stack.presets import PRESETS

from . import packed_sets
from .moment_cases import bumpy
from .no_default_weights import hide_defaults
from .quick_methods import quick_methods

WRAP = ("wrap", "wrap")

QUICK = quick_methods()


def run(method: str, stored: np.ndarray, target: str = "gltf", pixel_filter: str = "gaussian") -> list[np.ndarray]:
    return QUICK[method](stored, "gltf", target, pixel_filter, WRAP, lambda _: None).levels


@pytest.mark.long
@pytest.mark.parametrize("target", material.MODELS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [(24, 20), (1, 7), (1, 1)])
def test_every_method_fills_a_complete_valid_chain(method: str, target: str, size: tuple[int, int]) -> None:
    levels = run(method, bumpy(*size), target)
    assert [level.shape for level in levels] == [(*s, material.MODELS[target].channels) for s in level_sizes(*size)]
    low, high = np.array(material.MODELS[target].limits).T
    for level in levels:
        assert level.dtype == np.float32
        assert np.isfinite(level).all()
        assert (level >= low).all()
        assert (level <= high).all()
        for group in material.MODELS[target].unit_vectors:
            assert np.linalg.norm(level[..., group], axis=-1) == pytest.approx(1, abs=1e-5)


def test_neural_refuses_what_it_was_not_trained_for(monkeypatch: pytest.MonkeyPatch) -> None:
    hide_defaults(monkeypatch)
    with pytest.raises(UsageError, match=r"no trained weights.*'mitchell'") as error:
        run("neural", bumpy(24, 20), "beckmann", pixel_filter="mitchell")
    others = [i.name for i in list_weights() if "beckmann" in i.targets and "mitchell" in i.pixel_filters]
    assert others and all(name in str(error.value) for name in others)


def test_unknown_method_lists_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"'toksvig2'.*auto, neural, refine, optimum, lean, .*, linear"):
        method_named("toksvig2")


def test_budgets_are_seconds_minutes_hours_or_best() -> None:
    assert [seconds_of(text) for text in ("30s", "2m", " 1.5 m ", "0.5s", "90S")] == [30, 120, 90, 0.5, 90]
    assert [seconds_of(text) for text in ("2h", "1.5 H")] == [7200, 5400]
    assert seconds_of("best") is None

    for text in ("", "30", "0s", "-1m", "2d", "soon", "s", "nan s", "1e3s"):
        with pytest.raises(UsageError, match=r"a time above 0 in seconds, minutes or hours, .* or best"):
            seconds_of(text)


def test_auto_refines_with_a_budget_alone() -> None:
    given = DescentEffort(rounds=3)
    for name, seconds in (("auto", None), ("optimum", None), ("refine", REFINE_SECONDS)):
        usual, found = METHODS[name], [method_named(name, budget=budget) for budget in ("1.5m", "best")]
        assert isinstance(usual, Searching) and usual.seconds == seconds
        assert [each.seconds for each in found if isinstance(each, Searching)] == [90, None]
    for kind in (Auto, Refine, Optimum):
        assert all(kind(budget=budget, descent=given).plan.effort == given for budget in ("30s", "best"))
    assert Auto(budget="30s").plan == Refine(budget="30s").plan
    assert Auto(descent=given).plan.effort is None


@pytest.mark.parametrize("option", OPTIONS)
def test_methods_without_an_option_refuse_it(option: str) -> None:
    value = dict(weights=list_weights()[0].name, budget="1s", sampler="anisotropic", aim=1.0, device="cpu")[option]
    for name in METHODS:
        if name in OPTIONS[option]:
            assert method_named(name, **{option: value}).name == name
        else:
            with pytest.raises(UsageError, match=rf"method {name} takes no {option}: .*{'.*'.join(OPTIONS[option])}"):
                method_named(name, **{option: value})


def test_a_preset_chooses_for_a_call_as_it_does_for_a_command(tmp_path: Path) -> None:
    chosen = Recipe(preset="unreal").resolved()
    assert (chosen.sampler, chosen.target) == (PRESETS["unreal"].sampler, "gltf")
    assert Recipe(preset="unreal", sampler="trilinear", lod_bias=-1).resolved().sampler == Sampler(bias=-1)
    assert Recipe("lean", preset="unreal").resolved().sampler is None  # it takes none
    folder = packed_sets.orm(tmp_path / "wood")
    stack = mipbake.bake(folder, "linear", preset="unreal")
    plain = mipbake.bake(mipbake.load(folder), "linear", "gltf").provenance
    assert stack.provenance == replace(plain, preset="unreal")
    with pytest.raises(UsageError, match=r"unknown option 'samplers': did you mean sampler\? Options: method, target"):
        mipbake.bake(folder, samplers="trilinear")


def test_a_recipe_for_another_method_leaves_out_what_that_does_not_take() -> None:
    recipe = Recipe(target="gltf", sampler="anisotropic", aim=0.0, device="cpu")
    assert recipe.by("neural", "box") == replace(recipe, method="neural", pixel_filter="box", aim=None)
    assert recipe.by("linear", "box") == Recipe("linear", "gltf", "box")


def test_samplers_and_aims_that_no_stack_is_made_for_are_refused() -> None:
    for name in OPTIONS["sampler"]:
        with pytest.raises(UsageError, match=r"'stochastic': expected one of trilinear, anisotropic, accumulated"):
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
