"""benchmarks/aims.py, and the section of docs/results.md that is made from its record."""

from __future__ import annotations

import importlib
import json
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
