"""The files of benchmarks/results.py as one record a kind: the same figures, rounded, without what follows from
others."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from records.record import rounded

File = Mapping[str, Any]
"""What a file of benchmarks/results.py holds."""

_SPEC = ("name", "method", "kernel", "model", "weights", "sha256", "budget")
_EXTRA = ("crop", "model", "kind", "set", "together", "directionality", "slope")
_SCENE = ("name", "passes", "standard_error", "candidate_error", "converged")


def read_files(folder: Path) -> list[File]:
    """The files of one kind in a folder, in the order of their names."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]


def pack(files: Iterable[File]) -> dict[str, Any]:
    """The `data` of a record. Seconds are rounded to three digits, other figures to four."""
    packed: dict[str, Any] = {"effort": {}, "threads": 1, "lods": [], "scales": [], "methods": [], "sets": {}}
    for file in files:
        packed["effort"], packed["threads"] = file["key"]["effort"], file["threads"]
        specs = [{key: method[key] for key in _SPEC if method.get(key) is not None} for method in file["methods"]]
        if specs not in packed["methods"]:
            packed["methods"].append(specs)
        for axis, key, figures in (("lods", "lod", file["curve"]), ("scales", "scale", file["figures"])):
            packed[axis] += [value for value in dict.fromkeys(f[key] for f in figures) if value not in packed[axis]]
    packed["lods"].sort()
    for file in files:
        packed["sets"][file["name"]] = {
            "methods": packed["methods"].index(
                [{key: method[key] for key in _SPEC if method.get(key) is not None} for method in file["methods"]]
            ),
            **{key: rounded(file[key]) for key in _EXTRA if key in file},
            "costs": {method["name"]: rounded(method["processor_seconds"], 3) for method in file["methods"]},
            "curve": _table(file["curve"], ("view",), "lod", packed["lods"]),
            "figures": _table(file["figures"], ("measure", "view"), "scale", packed["scales"]),
            "scenes": [rounded({key: scene[key] for key in _SCENE if key in scene}, 3) for scene in file["scenes"]],
        }
    return packed


def unpack(packed: Mapping[str, Any]) -> list[File]:
    """What `pack` was given, as far as it was kept."""
    files: list[File] = []
    for name, each in packed["sets"].items():
        specs = packed["methods"][each["methods"]]
        files.append(
            {
                "name": name,
                "key": {"effort": packed["effort"]},
                "threads": packed["threads"],
                "methods": [
                    {"weights": None} | spec | {"processor_seconds": each["costs"][spec["name"]]} for spec in specs
                ],
                "curve": list(_listed(each["curve"], ("view",), "lod", packed["lods"])),
                "figures": list(_listed(each["figures"], ("measure", "view"), "scale", packed["scales"])),
                "scenes": each["scenes"],
                **{key: each[key] for key in _EXTRA if key in each},
            }
        )
    return files


def _table(
    figures: Sequence[Mapping[str, Any]], keys: Sequence[str], axis: str, places: Sequence[Any]
) -> dict[str, Any]:
    """Nested by `keys` and then the method, a list along `axis`; null where there is no figure."""
    table: dict[str, Any] = {}
    for figure in figures:
        at = table
        for key in keys:
            at = at.setdefault(figure[key], {})
        row = at.setdefault(figure["method"], [None] * len(places))
        row[places.index(figure[axis])] = rounded(float(figure["value"]))
    return table


def _listed(
    table: Mapping[str, Any], keys: Sequence[str], axis: str, places: Sequence[Any]
) -> Iterable[dict[str, Any]]:
    if keys:
        for name, inside in table.items():
            for figure in _listed(inside, keys[1:], axis, places):
                yield {keys[0]: name, **figure}
        return
    for method, row in table.items():
        for place, value in zip(places, row, strict=True):
            yield {"method": method, axis: place, "value": value}
