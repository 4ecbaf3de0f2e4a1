"""Made-up records of results, for tests of pages."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from mipbake.quality.metrics import PAIR_SETS

_ROOT = Path(__file__).resolve().parent.parent
LODS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0)
SCALES = ("near", "1:1", "middle", "far")

_LEARNED = ("neural", "paper-", "mipnet-")


def described(name: str, weights: str | None = None) -> dict[str, Any]:
    method = name.split(" ", maxsplit=1)[0]
    return {
        "name": name, "method": method if weights is None else "neural", "kernel": "gaussian", "model": "gltf",
        "weights": weights, "seconds": 2.0, "processor_seconds": 1.0 + len(name), "peak_mib": 99.4,
    }  # fmt: skip


def file(name: str, methods: Mapping[str, float], extra: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A set on which every method has one SNR everywhere, and FLIP and flicker that follow from it."""
    figures = []
    for method, snr in methods.items():
        for scale in SCALES:
            values = {"snr": snr + 3, "flip": 1 / (10 + snr)}
            figures += [
                {"method": method, "measure": m, "view": "sphere", "scale": scale, "value": v}
                for m, v in values.items()
            ]
            for pairs in PAIR_SETS:
                steady = 2.0 if method == "linear (box)" else 1.0 if snr > 15 else 0.5
                figures.append({"method": method, "measure": "flicker", "view": pairs, "scale": scale, "value": steady})
    return {
        "name": name,
        "methods": [described(m, "some-weights" if m.startswith(_LEARNED) else None) for m in methods],
        "curve": [
            {"method": m, "view": pairs, "lod": lod, "value": snr}
            for m, snr in methods.items()
            for pairs in PAIR_SETS
            for lod in LODS
        ],
        "figures": figures,
        "scenes": [{"converged": name == "first"}],
        "key": {"effort": {"points": 5, "samples": 6, "side": 7, "passes": 8}},
        "threads": 1,
        **(extra or {}),
    }


def write(folder: Path, kind: str, *files: dict[str, Any]) -> None:
    """Writes the files as a record, beside files of the same kind that are there."""
    record, results = (importlib.import_module(f"records.{name}") for name in ("record", "results"))
    name = f"results-{kind}"
    before = record.load(name, folder)
    save(folder, name, results.pack([*(results.unpack(before.data) if before else []), *files]))


def save(folder: Path, name: str, data: dict[str, Any]) -> None:
    """Writes a record."""
    record = importlib.import_module("records.record")
    record.Record(name, record.Measured("today", "a machine", 1.0, "0.1.0"), data, folder).save()


def maker(module: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> Callable[[], str]:
    """Makes the text of a page from the records in a folder; its charts go to the folder `docs` there."""
    monkeypatch.syspath_prepend(_ROOT / "docs")
    monkeypatch.syspath_prepend(_ROOT / "benchmarks")
    made = folder / "docs" / "page.md"
    made.parent.mkdir()
    return lambda: str(importlib.import_module(module).text(folder, made))


def row(text: str, start: str, after: str = "") -> str:
    """The first table row that begins so, below a heading."""
    part = text[text.index(after) :]
    return next(line for line in part.splitlines() if line.startswith(f"| {start} |"))
