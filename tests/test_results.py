"""benchmarks/results.py: what it measures, on which sets, and how a run goes on that was stopped."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mipbake import TextureSet
from mipbake.baking.pipeline import DEFAULT_FILTER, Recipe
from mipbake.base.errors import UsageError
from mipbake.comparing.candidates import bake_all
from mipbake.comparing.validate import DEFAULT_LODS
from mipbake.quality import texture_space

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module


def bumpy(size: int = 16, seed: int = 0) -> TextureSet:
    rng = np.random.default_rng(seed)
    slopes = rng.normal(0, 0.2, (size, size, 2))
    normal = np.concatenate([slopes, np.ones((size, size, 1))], -1)
    colour, roughness = rng.random((size, size, 3)), rng.uniform(0.2, 0.9, (size, size))
    return TextureSet.from_arrays("bumpy", normal=normal, roughness=roughness, base_color=colour, metallic=0.5)


def test_names_of_methods(module: Callable[[str], ModuleType], tmp_path: Path) -> None:
    specs = module("results_methods").specs
    found = specs(("lean", "linear (box)", "refine@30s", "neural:nobody"), "ggx", DEFAULT_FILTER)
    assert [spec.name for spec in found] == ["lean (box)", "lean (gaussian)", "linear (box)", "refine 30s"]
    assert [(spec.kernel, spec.budget) for spec in found[-2:]] == [("box", None), (DEFAULT_FILTER, "30s")]
    assert all(spec.target == "ggx" for spec in found)
    for wrong in ("nothing", "lean@30s", "auto:mipbake-3"):
        with pytest.raises(UsageError):
            specs((wrong,), "gltf", DEFAULT_FILTER)


@pytest.mark.long
def test_a_set_is_measured_as_validation_does(module: Callable[[str], ModuleType]) -> None:
    measure, methods = module("results_measure"), module("results_methods")
    texture_set, names = bumpy(), ("linear (box)", "lean (gaussian)")
    effort = measure.ResultsEffort(points=64, samples=4, side=24, passes=32)
    wanted = methods.specs(names, "gltf", DEFAULT_FILTER)
    found = measure.measured(measure.Plan("bumpy", lambda: texture_set, wanted, ("near",), ("near",)), effort)
    with bake_all(texture_set, Recipe(target="gltf"), names) as candidates:
        drawn = texture_space.MeasureEffort(points=64, samples=4)
        expected = texture_space.measure(
            texture_set.filtered(DEFAULT_FILTER), candidates, DEFAULT_LODS, ("near",), drawn
        )
    assert [(f["method"], f["lod"], f["value"]) for f in found["curve"]] == [
        (f.method, f.lod, f.value) for f in expected.curve
    ]
    measures = {f["measure"] for f in found["figures"] if f["view"] == "sphere"}
    assert {"snr", "flip"} <= measures and len(found["scenes"]) == 1
    for method in found["methods"]:
        assert method["processor_seconds"] > 0
    json.dumps(found, default=str)


def test_directional_sets_are_found_by_their_bumps_or_their_map(module: Callable[[str], ModuleType]) -> None:
    sets = module("results_sets")
    flat = np.broadcast_to(np.array([0, 0, 1.0]), (8, 8, 3))
    brushed = np.zeros((8, 8, 3))
    brushed[..., 0] = 1
    brushed[..., 2] = 0.5
    known = {
        "bumpy": bumpy,
        "brushed": lambda: TextureSet.from_arrays("brushed", normal=flat, roughness=0.5, anisotropy=brushed),
    }
    found = dict(sets.directional(known, 2, 32))
    assert "brushed" in found and "bumpy" not in found and len(found) == 3
    for name in (name for name in found if name.startswith("procedural-")):
        assert sets.bumps(found[name])["directionality"] >= sets.DIRECTIONAL
        assert int(name.split("-")[1]) >= 2_000_000  # training and its validation draw smaller seeds


@pytest.fixture
def run(
    module: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., tuple[int, list[str]]]:
    """Runs the script with one kind of two sets that count how often they are measured; exit code, and what was."""
    results, measure, methods = (module(name) for name in ("results", "results_measure", "results_methods"))
    (tmp_path / "sets").mkdir(exist_ok=True)
    measured: list[str] = []

    def kind(asked: object) -> list[object]:
        wanted = methods.specs(asked.methods, "gltf", DEFAULT_FILTER)
        return [measure.Plan(name, bumpy, wanted) for name in ("a", "b")]

    def fake(plan: object, effort: object) -> dict[str, object]:
        measured.append(plan.name)
        if plan.name == "a" and (tmp_path / "fail").exists():
            raise RuntimeError("no luck")
        return {"name": plan.name}

    def call(*arguments: str) -> tuple[int, list[str]]:
        measured.clear()
        monkeypatch.setattr(
            sys, "argv", ["results.py", str(tmp_path / "sets"), str(tmp_path / "out"), "--kinds", "one", *arguments]
        )
        return results.run(results.folders_and_threads(), {"one": kind}, fake), list(measured)

    return call


def test_a_run_goes_on_where_it_stopped(run: Callable[..., tuple[int, list[str]]], tmp_path: Path) -> None:
    assert run("--methods", "linear") == (0, ["a", "b"])
    assert run("--methods", "linear") == (0, [])
    (tmp_path / "out" / "one" / "b.json").unlink()
    assert run("--methods", "linear") == (0, ["b"])
    assert run("--methods", "linear", "--points", "7") == (0, ["a", "b"])  # other settings are other figures
    assert run("--methods", "lean", "--points", "7") == (0, ["a", "b"])
    key = json.loads((tmp_path / "out" / "one" / "a.json").read_text())["key"]
    assert key["effort"]["points"] == 7 and [spec["method"] for spec in key["methods"]] == ["lean", "lean"]


def test_a_set_that_fails_leaves_the_others(run, tmp_path, capsys):
    (tmp_path / "fail").touch()
    assert run("--methods", "linear") == (1, ["a", "b"])
    assert "one a: no luck" in capsys.readouterr().err
    assert not (tmp_path / "out" / "one" / "a.json").exists()
    (tmp_path / "fail").unlink()
    assert run("--methods", "linear") == (0, ["a"])


def test_every_kind_plans_its_sets(module: Callable[[str], ModuleType]) -> None:
    measure = module("results_measure")
    effort = measure.ResultsEffort(generated=1, generated_size=32, pairs=2, pairs_size=16, crop=128)
    wanted = measure.Asked({"bumpy": lambda: bumpy(160)}, ("auto",), (), effort)
    plans = {kind: make(wanted) for kind, make in measure.KINDS.items()}
    assert [plan.name for plan in plans["whole"]] == ["bumpy"]
    assert {spec.name for spec in plans["crop"][0].methods} >= {"optimum", "refine 7.5s", *measure.FORMS}
    assert plans["crop"][0].source().height == 128
    names = ["ggx--bumpy", "ggx--bumpy--boosted", "beckmann--bumpy", "beckmann--bumpy--boosted", "captured-0"]
    assert [plan.name for plan in plans["models"]] == names
    assert [plan.source().source_model for plan in plans["models"]] == ["ggx"] * 2 + ["beckmann"] * 3
    assert [plan.extra["kind"] for plan in plans["models"]] == ["plain", "boosted"] * 2 + ["captured"]
    assert [plan.extra["together"] for plan in plans["correlated"]] == [True, False] * 2
    named = {spec.name for spec in plans["directional"][0].methods}
    assert {"auto as gltf", "auto as gltf-anisotropic", "lean (box) as gltf-anisotropic"} <= named
    assert all(plan.source().width for plan in plans["directional"])


def test_twins_differ_in_which_values_meet_alone(module: Callable[[str], ModuleType]) -> None:
    sets = module("results_sets")
    first, second = (sets.correlated(3, 32, together).stored for together in (True, False))
    assert first.dtype == np.float32 and np.isfinite(first).all()
    for channel in range(first.shape[-1]):
        assert np.array_equal(np.sort(first[..., channel], None), np.sort(second[..., channel], None))

    def met(stored: np.ndarray) -> float:
        """How much of F0 the normals explain."""
        flat = np.concatenate([stored[..., 6:8], np.ones((*stored.shape[:2], 1))], -1).reshape(-1, 3)
        f0 = stored[..., 3].ravel()
        left = f0 - flat @ np.linalg.lstsq(flat, f0, rcond=None)[0]
        return float(1 - left.var() / f0.var())

    assert met(first) > 0.7 and met(second) < 0.3
