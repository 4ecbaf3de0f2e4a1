"""docs/libraries.md answers for every file of `io` and `metrics` whether a library would do its work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize("room", ["io", "metrics"])
def test_every_file_has_an_answer(room: str) -> None:
    page = (ROOT / "docs" / "libraries.md").read_text(encoding="utf-8")
    _, _, table = page.partition(f"| file of `{room}` |")
    rows = table.partition("\n\n")[0].splitlines()[2:]
    named = [name for row in rows for name in re.findall(r"`([\w/]+\.py)`", row.split("|")[1])]
    folder = ROOT / "mipbake" / room
    files = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*.py") if p.name != "__init__.py")
    assert sorted(named) == files
