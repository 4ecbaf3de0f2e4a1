"""docs/sources.md, what the sources claim and what holds here: whatever a row names is there."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "sources.md"
HEAD = ["section", "claim", "state", "shown by"]
STATES = ("reproduced", "differs", "not here")
NAMED_TEST = re.compile(r"`(tests/[^`:]*)::([^`]*)`")
NAMED_RECORD = re.compile(r"(waits for )?record `([^`]*)`")


@cache
def functions(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text(encoding="utf-8")) if path.is_file() else ast.Module([], [])
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


def rows() -> list[dict[str, str]]:
    lines = (line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("|"))
    cells = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines)
    return [
        dict(zip(HEAD, row, strict=True))
        for row in cells
        if len(row) == len(HEAD) and row != HEAD and set(row) != {"---"}
    ]


def test_whatever_a_row_names_is_there() -> None:
    found = rows()
    assert len(found) > 80
    faults = []
    for row in found:
        shown = row["shown by"]
        tests, records = NAMED_TEST.findall(shown), NAMED_RECORD.findall(shown)
        faults += [f"there is no test {file}::{name}" for file, name in tests if name not in functions(ROOT / file)]
        for waits, name in records:
            if (ROOT / "benchmarks" / "records" / f"{name}.json").is_file() == bool(waits):
                faults.append(f"record {name} is {'there' if waits else 'not there'}: {row['claim']}")
        if row["state"] not in STATES:
            faults.append(f"there is no state {row['state']!r}")
        if row["state"] == "reproduced" and not tests and not records:
            faults.append(f"nothing shows what is reproduced: {row['claim']}")
    assert not faults, "\n".join(faults)
