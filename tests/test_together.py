"""Closed forms in one pass: the bits of each form by itself, whether all texels are made or those that lookups read."""

from collections.abc import Mapping

import numpy as np
import pytest

from mipbake.baking.methods import METHODS
from mipbake.baking.rules import RULES, bands
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.together import Together
from mipbake.baking.search import touched
from mipbake.baking.search.touched import Touched, mixed
from mipbake.material import regularise
from mipbake.material.aim import SAMPLERS
from mipbake.material.pixel_filter import Wrap
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Scores
from mipbake.quality.reference.problem import Image, Problem

from .stacks import gltf_level

KERNELS = "gaussian", "box"

PROBES = ProbeEffort(groups=2, points=16, samples=1, pictures=8, picture_samples=1, doublings=0)


def forms_of(whole: Whole, target: str) -> dict[str, tuple[Form, str]]:
    rules = [(name, rule) for name, rule in RULES.items() if isinstance(rule, ClosedForm)]
    assert len(rules) == len(RULES)
    return {f"{name} ({kernel})": (rule.form(whole, target), kernel) for kernel in KERNELS for name, rule in rules}


def alone(problem: Problem, name: str) -> list[Image]:
    method, kernel = name.removesuffix(")").split(" (")
    return METHODS[method](problem.stored, problem.source, problem.target, kernel, problem.wrap, lambda _: None).levels


@pytest.fixture
def few_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bands, "ROWS", 9)
    monkeypatch.setattr(bands, "BAND", 1)


@pytest.mark.long
@pytest.mark.parametrize("size", [(64, 64), (70, 61), (5, 40), (1, 1)])
@pytest.mark.parametrize("wrap", [("wrap", "wrap"), ("wrap", "clamp"), ("clamp", "clamp")])
@pytest.mark.parametrize("target", ["gltf", "ggx"])
@pytest.mark.usefixtures("few_rows")
def test_forms_in_one_pass_have_the_bits_of_each_by_itself(size: tuple[int, int], wrap: Wrap, target: str) -> None:
    problem = Problem(gltf_level(size, 3), "gltf", target, "gaussian", wrap)
    whole = Whole(problem.stored, "gltf")
    forms = forms_of(whole, target)
    together = Together(whole, list(forms.values()), wrap)
    shapes = [alone(problem, "linear (box)")[level].shape for level in range(problem.last + 1)]
    found = {name: [np.empty(shape, np.float32) for shape in shapes] for name in forms}

    def take(level: int, rows: slice, averages: Mapping[str, Image]) -> None:
        planes = {name: np.ascontiguousarray(each.transpose(2, 0, 1)) for name, each in averages.items()}
        for name, form in zip(forms, together.placed, strict=True):
            found[name][level][rows] = form.made(planes, level)

    together.show(take)
    for name, levels in found.items():
        for one, other in zip(levels, alone(problem, name), strict=True):
            np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.usefixtures("few_rows")
def test_mixtures_are_sums_of_whole_levels() -> None:
    problem = Problem(gltf_level((64, 48), 3), "gltf", "gltf", "gaussian", ("wrap", "clamp"))
    whole, rng = Whole(problem.stored, "gltf"), np.random.default_rng(0)
    forms = forms_of(whole, "gltf")
    network = alone(problem, "vmf (box)")  # stands for an ingredient that is baked by itself
    names = ["lean (gaussian)", "network", "unreal (box)", "linear (gaussian)"]
    mixtures = [{name: rng.random(8) for name in names[level % 3 :]} for level in range(problem.last)]
    mixtures.append({"network": np.ones(8)})
    expected = [np.zeros((*size, 8), np.float32) for size in problem.sizes]
    for name in names:
        levels = network if name == "network" else alone(problem, name)
        for level, mixture in enumerate(mixtures):
            if name in mixture:
                expected[level] += levels[level] * mixture[name].astype(np.float32)
    found = mixed(problem, whole, forms, {"network": [each.copy() for each in network]}, mixtures)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, regularise(other, "gltf"))
    alone_again = mixed(problem, whole, forms, {"network": network}, [{"network": np.ones(8)}] * len(mixtures))
    assert len(alone_again) == len(mixtures)


@pytest.mark.long
@pytest.mark.parametrize("most", [0.0, 2.0], ids=["all texels", "texels that lookups read"])
@pytest.mark.parametrize("sampler", ["trilinear", "anisotropic"])
@pytest.mark.usefixtures("few_rows")
def test_lookups_of_few_texels_have_the_bits_of_lookups_of_levels(monkeypatch, most, sampler):
    monkeypatch.setattr(touched, "MOST", most)
    problem = Problem(gltf_level((64, 96), 3), "gltf", "gltf", "gaussian", ("wrap", "clamp"), SAMPLERS[sampler])
    whole = Whole(problem.stored, "gltf")
    forms = forms_of(whole, "gltf")
    sets = [Scores(problem, PROBES, seed, range(problem.last + 1)) for seed in range(2)]
    together = Together(whole, list(forms.values()), problem.wrap)
    some = Touched(problem, sets)
    some.gather(together)
    for name, placed in zip(forms, together.placed, strict=True):
        levels = alone(problem, name)
        for level in range(problem.last + 1):
            texels = some.made(placed, level)
            for which, each in enumerate(sets):
                seen = some.seen(texels, which, level)
                np.testing.assert_array_equal(seen, each.looked_up(levels[level], level), err_msg=name)
