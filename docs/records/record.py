"""A record: figures that were measured, with the release and the golden outputs that they were measured with.

A record is a JSON file in benchmarks/records. The golden outputs (tests/golden) are small stacks, training steps and
films. A record holds a digest of each kind of them. Where today's digests are others, today's figures may be others,
and the pages that print the record say so. Nothing fails because code changed. Records of time and of trainings hold
the machine or the revision, and no digests.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "benchmarks" / "records"
GOLDEN = ROOT / "tests" / "golden" / "record.json"

KINDS = ("stacks", "trainings", "films")
"""What golden outputs there are. The name of each output begins with its kind."""


class Missing(KeyError):  # noqa: N818 - it says what a record is, and is not a fault
    """A record that has not been measured."""


@dataclass(frozen=True)
class Measured:
    """When and on what a record was measured.

    Args:
        on: date. machine: its processor and its instruction set. seconds: of processors that it took.
        release: version of mipbake.
        goldens: kind of golden output to a digest; empty for records of time and of trainings.
    """

    on: str
    machine: str
    seconds: float
    release: str
    goldens: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Record:
    """What a file in benchmarks/records holds.

    Args:
        name: of the file, without its ending. data: the figures, as JSON.
    """

    name: str
    measured: Measured
    data: Any
    folder: Path = field(default=FOLDER, compare=False)

    def save(self) -> Path:
        """Writes the file: figures one line for each member of `data`, so that changes can be read."""
        self.folder.mkdir(parents=True, exist_ok=True)
        head = json.dumps({"measured": asdict(self.measured)}, indent=1, ensure_ascii=False)
        path = self.folder / f"{self.name}.json"
        path.write_text(head[:-2] + ',\n "data": ' + _lines(self.data) + "\n}\n", encoding="utf-8")
        return path


class Records:
    """The data of records, by name; Missing where there is none."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self.folder = folder

    def __getitem__(self, name: str) -> Any:
        return self.record(name).data

    def record(self, name: str) -> Record:
        found = load(name, self.folder)
        if found is None:
            raise Missing(name)
        return found


def load(name: str, folder: Path = FOLDER) -> Record | None:
    """The record of that name; None where it has not been measured."""
    path = folder / f"{name}.json"
    if not path.exists():
        return None
    found = json.loads(path.read_text(encoding="utf-8"))
    return Record(name, Measured(**found["measured"]), found["data"], folder)


def goldens(path: Path = GOLDEN) -> dict[str, str]:
    """Kind of golden output to a digest of the outputs that are recorded today."""
    results = json.loads(path.read_text(encoding="utf-8"))["results"]
    found = {kind: {name: each["bits"] for name, each in results.items() if name.startswith(kind)} for kind in KINDS}
    return {kind: hashlib.sha256(json.dumps(each).encode()).hexdigest()[:12] for kind, each in found.items()}


def rounded(value: Any, digits: int = 4) -> Any:
    """JSON with so many significant digits in its numbers; numbers that are not finite are null."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): rounded(each, digits) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each, digits) for each in value]
    return value


def _lines(value: Any, depth: int = 2, margin: int = 1) -> str:
    """JSON whose first members have lines of their own."""
    inside = " " * (margin + 1)
    if depth and isinstance(value, Mapping) and value:
        rows = [f"{inside}{json.dumps(name)}: {_lines(each, depth - 1, margin + 1)}" for name, each in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + " " * margin + "}"
    if depth and isinstance(value, list) and any(isinstance(each, Mapping | list) for each in value):
        rows = [inside + _lines(each, depth - 1, margin + 1) for each in value]
        return "[\n" + ",\n".join(rows) + "\n" + " " * margin + "]"
    return json.dumps(value, ensure_ascii=False)
