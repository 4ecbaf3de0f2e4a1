"""What the page on scaling makes of figures."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent

PART = {"seconds": 4.0, "processor": 7.2, "phases": {"read": 1.0, "prefilter": 2.0, "check": 1.0}, "memory": 2 << 30,
        "read": 60_000_000, "written": 90_000_000}  # fmt: skip
FOUND: dict[str, Any] = {
    "cores": 2,
    "sizes": {
        "64": {"sets": 2, "maketx": {"1": 900.0, "2": 1500.0}, "linear": {"1": 450.0, "2": 700.0}},
        "128": {"sets": 2, "maketx": {"1": 800.0, "2": 1000.0}, "linear": {"1": 400.0, "2": 500.0},
                "neural": {"1": 400.0, "2": 800.0}},
    },
    "formats": {"png": {"1": 100.0, "2": 150.0}},
    "parts": {name: {**PART, "held": {**PART, "processor": 7.2, "memory": 2 << 30}} for name in ("linear", "neural")},
}  # fmt: skip


class Records(dict[str, Any]):
    def record(self, name: str) -> Any:
        return SimpleNamespace(data=self[name], measured=SimpleNamespace(on="2026-01-02", machine="a machine"))


@pytest.fixture
def views(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("records.views_scaling")


def test_hours(views: ModuleType) -> None:
    """Half of two cores is busy with 500 sets an hour of 7.2 processor seconds, and 80 % with 800."""
    assert views.in_use(FOUND, "linear") == pytest.approx(0.5)
    assert views.in_use(FOUND, "neural") == pytest.approx(0.8)
    machine = views.Machine("m", cores=8, memory=64, disk=100.0)
    assert views.hours(FOUND, "linear", machine) == (pytest.approx(10_000 * 7.2 / 4 / 3600), "cores")
    assert views.hours(FOUND, "linear", views.Machine("m", 8, 4, 100.0)) == (pytest.approx(20.0), "memory")
    assert views.hours(FOUND, "linear", views.Machine("m", 8, 64, 0.05))[1] == "disk"
    assert views.hours(FOUND, "linear", views.Machine("m", 8, 64, 0.05))[0] == pytest.approx(30_000 / 3600)
    free = views.Machine("m", 8, 64, 100.0, network_free=True)
    assert views.hours(FOUND, "neural", free)[0] == pytest.approx(10_000 * 3.6 / 6.4 / 3600)
    assert views.hours(FOUND, "linear", free) == views.hours(FOUND, "linear", machine)


def test_tables(views: ModuleType) -> None:
    records = Records({"throughput": FOUND, "throughput-large": FOUND})
    by_size = views.throughput_by_size(records)
    assert "| 64 x 64 | linear | 450 | 700 | 1.56 | 0.50 |" in by_size
    assert by_size.endswith("Measured 2026-01-02 on a machine.")
    assert "| png | 100 | 150 | 1.50 |" in views.throughput_by_format(records)
    assert "| linear | 1.0 | 2.0 | 1.0 | 4.0 | 7.2 | 2.00 | 7.2 | 2.00 | 60 | 90 |" in views.throughput_parts(records)
    assert "50% with linear, 80% with neural" in views.ten_thousand(records)
