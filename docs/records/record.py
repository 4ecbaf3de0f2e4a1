"""A record: figures that were measured, with the code and the weights that they were measured with.

A record is a JSON file in benchmarks/records. It is *current* while the hashes of the code and the weights that it
depends on are those that it holds. When they change, it is *stale*: the test of records fails until it is measured
again, or until a sample of it is. A sample is measured with the changed code, and must agree with the record within
a tolerance; the record is then *confirmed*, and says by what sample. Which sample is drawn from the hash of the
code: nobody can choose one that agrees. Records of time hold the machine and are not compared with the code: any
change would make them stale, and no sample of a shared machine would confirm them.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from records.code import ROOT, Hashes, changes, together

FOLDER = ROOT / "benchmarks" / "records"

State = Literal["missing", "stale", "confirmed", "current"]


@dataclass(frozen=True)
class Measured:
    """When and on what a record was measured.

    Args:
        on: date. machine: its processor. seconds: of processors that it took.
        code: one hash of the code and the weights.
    """

    on: str
    machine: str
    seconds: float
    code: str


@dataclass(frozen=True)
class Confirmed:
    """Says that a sample of a record agreed with it.

    Args:
        on: date. sample: what was measured again.
        figures: how many were compared. largest: the largest difference as a share of what is tolerated.
        code: one hash of the code and the weights that the sample was measured with.
    """

    on: str
    sample: str
    figures: int
    largest: float
    code: str


@dataclass(frozen=True)
class Record:
    """What a file in benchmarks/records holds.

    Args:
        name: of the file, without its ending.
        measured, confirmed: see there; None where no sample was needed since it was measured.
        code: hashes of the files that it depends on, as of the later of both; empty for records of time.
        data: the figures, as JSON.
    """

    name: str
    measured: Measured
    code: Hashes
    data: Any
    confirmed: Confirmed | None = None
    folder: Path = field(default=FOLDER, compare=False)

    def save(self) -> Path:
        """Writes the file: figures one line for each member of `data`, so that changes can be read."""
        self.folder.mkdir(parents=True, exist_ok=True)
        head = {
            "measured": asdict(self.measured),
            "confirmed": asdict(self.confirmed) if self.confirmed else None,
            "code": self.code,
        }
        text = json.dumps(head, indent=1, ensure_ascii=False)[:-2] + ',\n "data": ' + _lines(self.data) + "\n}\n"
        path = self.folder / f"{self.name}.json"
        path.write_text(text, encoding="utf-8")
        return path


def load(name: str, folder: Path = FOLDER) -> Record | None:
    """The record of that name; None where it has not been measured."""
    path = folder / f"{name}.json"
    if not path.exists():
        return None
    found = json.loads(path.read_text(encoding="utf-8"))
    confirmed = Confirmed(**found["confirmed"]) if found["confirmed"] else None
    return Record(name, Measured(**found["measured"]), found["code"], found["data"], confirmed, folder)


def state(record: Record | None, now: Hashes) -> tuple[State, list[str]]:
    """Whether a record may be printed, and what changed where it may not."""
    if record is None:
        return "missing", []
    changed = changes(record.code, now)
    return ("stale" if changed else "confirmed" if record.confirmed else "current"), changed


def drawn(names: Sequence[str], count: int, now: Hashes) -> list[str]:
    """A sample of names, by the hash of the code."""
    return sorted(random.Random(together(now)).sample(sorted(names), min(count, len(names))))


def rounded(value: Any, digits: int = 4) -> Any:
    """JSON with so many significant digits in its numbers; numbers that are not finite are null."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): rounded(each, digits) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each, digits) for each in value]
    return value


@dataclass(frozen=True)
class Difference:
    """A figure of a sample beside the record's.

    Args:
        name: where it stands. share: the difference as a share of what is tolerated.
    """

    name: str
    record: float
    sample: float
    share: float


def confirmed(record: Record, now: Hashes, on: str, sample: str, found: Sequence[Difference]) -> Record:
    """The record, stamped with the code of today."""
    about = Confirmed(on, sample, len(found), round(max(each.share for each in found), 3), together(now))
    return replace(record, code=now, confirmed=about)


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
