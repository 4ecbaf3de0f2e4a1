"""The records of benchmarks/results.py: one kind of measurement as arrays over sets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from records.record import load
from records.results import File, unpack

from mipbake.baking.methods import METHODS

SUBJECT, OPTIMUM, LINEAR = "neural", "optimum", "linear (box)"
FOUR = ("linear (box)", "linear (gaussian)", "lean (box)", "lean (gaussian)")

Key = tuple[str, str, str, str]
"""Method, measure, view and scale."""


@dataclass(frozen=True)
class Results:
    """The files of one kind.

    Args:
        sets: their names.
        methods: what every file has, in their order; as the files describe them.
        curve: method, pair set and lod to a figure a set. figures: the same of every measure and scale.
        scenes: of all sets, as in the files.
        seconds: method to seconds of processors that its bake took, a figure a set.
        files: the files themselves.
    """

    sets: Sequence[str]
    methods: Mapping[str, Mapping[str, Any]]
    curve: Mapping[tuple[str, str, float], np.ndarray]
    figures: Mapping[Key, np.ndarray]
    scenes: Sequence[Mapping[str, Any]]
    seconds: Mapping[str, np.ndarray]
    files: Sequence[File]

    @property
    def lods(self) -> list[float]:
        """Levels of detail that all sets have."""
        return sorted({lod for _, _, lod in self.curve})

    @property
    def closed_forms(self) -> list[str]:
        """Methods that average."""
        return [name for name, each in self.methods.items() if METHODS[each["method"]].averages]

    @property
    def learned(self) -> list[str]:
        """Methods that are not closed forms, without the optimum, which is a limit."""
        return [name for name in self.methods if name not in (*self.closed_forms, OPTIMUM)]

    def best_of(self, pairs: str, lod: float, names: Sequence[str] | None = None) -> np.ndarray:
        """The best of those methods for every set, by default of all closed forms: an oracle, (sets,)."""
        return np.asarray(np.max([self.curve[name, pairs, lod] for name in names or self.closed_forms], 0))

    def gains(self, name: str, pairs: str, rivals: Sequence[str] | None = None) -> np.ndarray:
        """dB over the best of the rivals, (sets, lods)."""
        rows = [self.curve[name, pairs, lod] - self.best_of(pairs, lod, rivals) for lod in self.lods]
        return np.stack(rows, 1)


def read(folder: Path, kind: str, wanted: Callable[[File], bool] = lambda _file: True) -> Results | None:
    """The results of a kind, of a folder of records; None where there are none."""
    record = load(f"results-{kind}", folder)
    files = [file for file in unpack(record.data) if wanted(file)] if record else []
    if not files:
        return None
    names = [{m["name"] for m in file["methods"]} for file in files]
    methods = {m["name"]: m for m in files[0]["methods"] if all(m["name"] in each for each in names)}
    curve: dict[tuple[str, str, float], list[float]] = {}
    figures: dict[Key, list[float]] = {}
    seconds: dict[str, list[float]] = {}
    for file in files:
        for f in file["curve"]:
            if f["value"] is not None:  # small sets have fewer levels
                curve.setdefault((f["method"], f["view"], f["lod"]), []).append(f["value"])
        for f in file["figures"]:
            value = math.nan if f["value"] is None else f["value"]
            figures.setdefault((f["method"], f["measure"], f["view"], f["scale"]), []).append(value)
        for m in file["methods"]:
            seconds.setdefault(m["name"], []).append(m["processor_seconds"])
    return Results(
        [file["name"] for file in files],
        methods,
        _everywhere(curve, len(files)),
        _everywhere(figures, len(files)),
        [scene for file in files for scene in file["scenes"]],
        _everywhere(seconds, len(files)),
        files,
    )


def _everywhere(found: Mapping[Any, list[float]], count: int) -> dict[Any, np.ndarray]:
    """Arrays of what every file has: small sets have fewer levels, and their last stands for far."""
    return {key: np.array(values, np.float64) for key, values in found.items() if len(values) == count}
