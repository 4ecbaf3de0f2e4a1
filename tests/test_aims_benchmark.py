"""benchmarks/aims.py, and the section of docs/results.md that is made from its record."""

from __future__ import annotations

import importlib
import json
import math
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.terms import PICTURES
from mipbake.quality.metrics import PAIR_SETS

from .test_results import bumpy

ROOT = Path(__file__).resolve().parent.parent
NAMES = (*PAIR_SETS, *PICTURES)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    for folder in ("docs", "benchmarks"):
        monkeypatch.syspath_prepend(ROOT / folder)
    return importlib.import_module


def test_parts_of_some_sets_are_measured(module: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script: ModuleType = module("aims")
    forms = [each for each in script.methods() if each[0] in ("linear (box)", "lean (gaussian)")]
    monkeypatch.setattr(script, "methods", lambda: iter(forms))
    monkeypatch.setattr(script, "EFFORT", ProbeEffort(groups=2, points=8, samples=4, pictures=8, picture_samples=2))
    monkeypatch.setattr(script, "SIDE", 16)
    monkeypatch.setattr(script, "SETS", 2)
    monkeypatch.setattr(script, "folder_sets", lambda _folder: {name: lambda: bumpy(32) for name in "abcd"})
    monkeypatch.setattr(sys, "argv", ["aims.py", "sets", str(tmp_path / "out.json")])
    script.main()
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["side"] == 16 and list(found["sets"]) == ["a", "c"]
    for methods in found["sets"].values():
        assert set(methods) == {"linear (box)", "lean (gaussian)"}
        assert all(tuple(figures) == NAMES for figures in methods.values())
        assert all(figures[kind] > 0 for figures in methods.values() for kind in PICTURES)
        assert methods["linear (box)"] != methods["lean (gaussian)"]


def test_every_aim_and_both_limits_are_measured(module: Any) -> None:
    names = [name for name, _, _ in module("aims").methods()]
    page = module("results_page.aims")
    assert [n for n in names if n.startswith("auto")] == [f"auto, aim {aim:g}" for aim in (0, 0.25, 0.5, 0.75, 1)]
    assert {"neural", "optimum", page.LIMIT, page.PLAIN} < set(names) and len(names) == len(set(names))


def test_the_section_says_what_the_record_holds(module: Any, tmp_path: Path) -> None:
    record, page = module("records.record"), module("results_page.aims")
    assert page.section(tmp_path) == []

    def figures(snr: float, seen: float) -> dict[str, float]:
        return {**dict.fromkeys(PAIR_SETS, snr), **dict.fromkeys(PICTURES, seen)}

    seen = {"linear (box)": 0.8, "lean (box)": 0.4, "neural": 0.4 / math.sqrt(2), "auto, aim 0": 0.4,
            "auto, aim 1": 0.2, "optimum": 0.3, page.LIMIT: 0.1}  # fmt: skip
    sets = {
        "one": {name: figures(10.0, value) for name, value in seen.items()},
        "two": {name: figures(20.0, 4 * value) for name, value in seen.items()},
    }
    sets["two"]["linear (box)"], sets["two"]["lean (box)"] = sets["two"]["lean (box)"], sets["two"]["linear (box)"]
    measured = record.Measured("today", "a machine", 1.0, "0.1.0")
    record.Record("aims", measured, {"side": 16, "sets": sets}, tmp_path).save()
    text = "\n".join(page.section(tmp_path))
    assert "On the middle 16 x 16 texels of each of 2 sets" in text
    assert "| linear (box) | 15.0 | 15.0 | 1.131 | 1.131 |  |" in text
    assert "| best closed form | 15.0 | 15.0 | 0.800 | 0.800 |  |" in text  # another form in each set
    assert "| auto, aim 0 | 15.0 | 15.0 | 0.800 | 0.800 | 0% |" in text
    assert "| auto, aim 1 | 15.0 | 15.0 | 0.400 | 0.400 | 50% |" in text
    assert "| neural | 15.0 | 15.0 | 0.566 | 0.566 | 25% |" in text
