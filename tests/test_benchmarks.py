"""benchmarks/films.py and benchmarks/aims.py: what is baked and measured, and how a run goes on."""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import pytest

from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.metrics import PAIR_SETS
from mipbake.stack.verdict import Outcome

from .test_results import bumpy

ROOT = Path(__file__).resolve().parent.parent
METHODS = ("neural", "linear (box)", "lean (gaussian)")


@pytest.fixture
def films(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, with few methods and without ColorVideoVDP, which takes its time."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    script = importlib.import_module("films")
    monkeypatch.setattr(script, "ACCUMULATED", METHODS[:2])
    monkeypatch.setattr(script, "check_color_video_vdp", lambda: None)
    monkeypatch.setattr("mipbake.comparing.filming.missing_judge", lambda: "not installed")
    return script


def test_methods_are_baked_for_the_sampler_that_looks_them_up(films, monkeypatch, tmp_path):
    baked: list[tuple[str, str]] = []
    bake_all = films.bake_all

    def counted(texture_set: Any, recipe: Any, names: Any) -> Any:
        baked.extend((name, str(recipe.sampler)) for name in names)
        return bake_all(texture_set, recipe, names)

    monkeypatch.setattr(films, "bake_all", counted)
    found = films.measured(bumpy(32), "lamps", tmp_path, films.FilmsEffort(32, 2, 16, METHODS))
    samplers = ("trilinear", "anisotropic", "accumulated", "accumulated, bias -1")
    assert baked == [
        ("linear (box)", "None"), ("lean (gaussian)", "None"), *(("neural", sampler) for sampler in samplers),
    ]  # fmt: skip
    assert len(list(tmp_path.iterdir())) == 4  # a reference a scene, for all samplers
    scenes = ("film-floor", "film-low-floor", "film-wall", "film-sphere")
    where = [(each["sampler"], each["scene"]) for each in found["films"]]
    assert where == list(itertools.product(samplers, scenes))
    for each in found["films"]:
        assert tuple(each["figures"]) == (METHODS[:2] if each["sampler"] in samplers[2:] else METHODS)
        for figures in each["figures"].values():
            assert {"snr", "flip", "sparkle", "flicker", "snr-displayed", "visible"} <= set(figures)
            # A display hides what is bright.
            assert figures["visible"] > 0 and figures["snr-displayed"] > figures["snr"]
    assert found["lighting"] == "lamps" and found["network"].startswith("mipbake")
    assert 0 < found["roughness"] < 1 and found["slope"] > 0


def test_verdicts_of_bakes_are_held_beside_their_films(films, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(films, "SAMPLERS", ("trilinear",))
    effort = films.FilmsEffort(32, 2, 16, ("linear (box)", "auto"))
    found = films.measured(bumpy(32), "lamps", tmp_path, effort)
    said = found["verdicts"]["trilinear"]
    assert said["outcome"] in get_args(Outcome) and said["sentence"].endswith(".") and said["advice"]
    for film in found["films"]:
        assert tuple(film["figures"]) == effort.methods
        for index, figures in enumerate(film["figures"].values()):
            figures["jod-37"] = 8 + 0.25 * index
    monkeypatch.setattr(films, "folder_sets", lambda _: {"a": lambda: None})
    monkeypatch.setattr(films, "measured", lambda *_: found)
    monkeypatch.setattr(sys, "argv", ["films.py", "sets", str(tmp_path / "out")])
    films.main()
    assert f"  trilinear: +0.25 JOD; verdict: {said['sentence']} {said['advice']}\n" in capsys.readouterr().out


def test_sets_are_measured_in_pieces(films, monkeypatch, tmp_path, capsys):
    done: list[tuple[str, str]] = []

    def measured(texture_set: str, lighting: str, work: Path, effort: Any) -> dict[str, Any]:
        done.append((texture_set, lighting))
        assert work.name == texture_set
        film = {"scene": "film-floor", "sampler": "trilinear", "figures": {"neural": {"jod-37": 9.0}}}
        kept = dataclasses.asdict(effort) | {"methods": list(effort.methods)}
        return {"effort": kept, "lighting": lighting, "films": [film], "processor_seconds": 1}

    monkeypatch.setattr(films, "folder_sets", lambda _: {name: lambda name=name: name for name in "dabc"})
    monkeypatch.setattr(films, "measured", measured)
    results = tmp_path / "results.json"

    def run(*more: str) -> list[tuple[str, str]]:
        done.clear()
        monkeypatch.setattr(sys, "argv", ["films.py", "sets", str(tmp_path / "out"), *more])
        films.main()
        return list(done)

    assert run("--plans", "d", "b") == [("b", "sky"), ("d", "studio")]  # lightings go by all sets
    assert run("--results", str(results)) == [("a", "studio"), ("c", "lamps")]
    assert list(json.loads(results.read_text())["sets"]) == ["a", "b", "c", "d"]
    assert run() == [] and "  film-floor, trilinear: JOD of neural 9.00\n" in capsys.readouterr().out
    assert run("--plans", "a", "--frames", "4") == [("a", "studio")]  # other settings are other figures
    with pytest.raises(SystemExit, match="no set e: expected some of d, a, b, c"):
        run("--plans", "e")


def test_options_have_the_type_of_their_default_and_bad_ones_are_refused(monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    timing = importlib.import_module("timing")
    parser = timing.parser_of("", "place", sides=(1, 2), steps=0, rate=0.5, only=(), set=tmp_path, out=None, fast=False)
    given = ["a", "--sides", "3", "--steps", "0", "--rate", "0", "--only", "b", "c", "--set", "d", "--fast"]
    found = vars(parser.parse_args(given))
    paths = {"place": Path("a"), "set": Path("d"), "out": None}
    assert found == {**paths, "sides": [3], "steps": 0, "rate": 0, "only": ["b", "c"], "fast": True}
    for option, text, wanted in (("--sides", "0", "whole number of at least 1"),
                                 ("--sides", "x", "whole number of at least 1"),
                                 ("--steps", "-1", "whole number of at least 0"),
                                 ("--rate", "-1", "number of at least 0"),
                                 ("--rate", "inf", "number of at least 0")):  # fmt: skip
        with pytest.raises(SystemExit):
            parser.parse_args(["a", option, text])
        assert f"argument {option}: expected a {wanted}, got '{text}'" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="no set b: expected some of a, c"):
        timing.expect("set", ["a", "b"], ["a", "c"])


def test_aims_of_parts_of_some_sets(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    script = importlib.import_module("aims")
    every = list(script.methods())
    assert [n for n, _, _ in every if n.startswith("auto")] == [f"auto, aim {aim:g}" for aim in (0, 0.25, 0.5, 0.75, 1)]
    names = ("linear (box)", "lean (gaussian)")
    monkeypatch.setattr(script, "methods", lambda: iter([each for each in every if each[0] in names]))
    monkeypatch.setattr(script, "EFFORT", ProbeEffort(groups=2, points=8, samples=4, pictures=8, picture_samples=2))
    monkeypatch.setattr(script, "SIDE", 16)
    monkeypatch.setattr(script, "SETS", 2)
    monkeypatch.setattr(script, "folder_sets", lambda _folder: {name: lambda: bumpy(32) for name in "abcd"})
    monkeypatch.setattr(sys, "argv", ["aims.py", "sets", "--results", str(tmp_path / "out.json")])
    script.main()
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["side"] == 16 and list(found["sets"]) == ["a", "c"]
    for methods in found["sets"].values():
        plain, lean = (methods[name] for name in names)
        assert tuple(plain)[:2] == tuple(PAIR_SETS) and plain != lean and all(plain[pairs] > 0 for pairs in PAIR_SETS)
        assert all(error > 0 for name, error in lean.items() if name not in PAIR_SETS)
