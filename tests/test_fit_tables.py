"""benchmarks/fit_tables.py: what the tables of fits say in words."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

STAGED = {"start": 0.0, "steps": 0.0}
"""Rows that words say nothing of."""

ROOT = Path(__file__).resolve().parent.parent


def one(scales: dict[str, dict[str, float]]) -> dict[str, Any]:
    """A set whose methods have these SNR in dB at each scale: sums are of one view, signal, error, noise."""
    return {
        "scales": {
            scale: [{"sums": {"snr": {name: [1.0, 10 ** (-snr / 10), 0.0] for name, snr in found.items()}}}]
            for scale, found in scales.items()
        }
    }


def test_words_count_what_is_ahead_equal_and_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    tables = importlib.import_module("fit_tables")
    others = {"linear": 10.0, "lean": 12.0, "auto": 11.0}
    first = one({"near": others | STAGED | {"fitted": 12.04}, "far": others | STAGED | {"fitted": 13.0}})
    second = one({"near": others | STAGED | {"fitted": 11.6}, "far": others | STAGED | {"fitted": 12.2}})
    said = tables.words({"renderers": {"gl": {"a": first, "b": second}}}, "snr")
    assert said == (
        "In `gl`, the fitted stack is ahead of the best of the other three at 2 of 4 scales of 2 sets, equal to it at "
        "1, and behind it at 1, at most by 0.4 dB (b, near). In the mean, the difference to the best of them is "
        "+0.2 dB."
    )
    both = tables.words({"renderers": {"gl": {"a": first}, "three": {"b": second}}}, "snr")
    assert both.endswith(
        "Over all renderers, the fitted stack is ahead at 0 of 2 (near, -0.2 dB in the mean), 2 of 2 (far, +0.6 dB in "
        "the mean)."
    )


def test_stages_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    tables = importlib.import_module("fit_tables")
    others = {"linear": 9.0, "lean": 9.0, "auto": 10.0}
    first = one({"near": others | {"start": 10.0, "steps": 10.5, "fitted": 10.46}})
    second = one({"near": others | {"start": 10.4, "steps": 10.7, "fitted": 10.7}})
    lines = tables.stages_table({"renderers": {"gl": {"a": first, "b": second}}}, "snr").splitlines()
    assert lines[2:] == [
        "| gl | start | +0.2 |  |  |  |",
        "| gl | steps | +0.4 |  |  |  |",
        "| gl | fitted | +0.0 |  |  |  |",
    ]
