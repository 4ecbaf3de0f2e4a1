"""The tables of rooms in docs/architecture.md, as they are printed, and what the code really does."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rooms.folders import ROOT
from rooms.imports import NATIVE, PACKAGE, imported, modules

PAGE = ROOT / "docs" / "architecture.md"
EVERYWHERE = "errors"
"""The room that every room may import, as the page says above the table."""

_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Args:
        rooms: in their order in the row.
        about: what lives there.
        may: rooms that these may import or include.
    """

    rooms: tuple[str, ...]
    about: str
    may: tuple[str, ...]


def rows(verb: str) -> list[Row]:
    """The table whose last column is `may VERB`, from the lowest room to the highest."""
    lines = iter(PAGE.read_text(encoding="utf-8").splitlines())
    next(line for line in lines if line == f"| room | what lives there | may {verb} |")
    next(lines)
    found = []
    for line in lines:
        if not line.startswith("|"):
            break
        rooms, about, may = (cell.strip() for cell in line.strip().strip("|").split("|"))
        found.append(Row(_names(rooms), about, _names(may)))
    return found


def _names(cell: str) -> tuple[str, ...]:
    """The names of a cell, which says nothing else."""
    assert re.fullmatch(r"(`[\w./]+`(, (?=`)|$))*", cell), f"expected names in backticks, with commas: {cell}"
    return tuple(re.findall(r"`([^`]+)`", cell))


def room_of(name: str, rooms: Iterable[str]) -> str | None:
    """The room that something of a dotted name or a path lies in: the innermost of those that have it."""
    return max((room for room in rooms if re.match(rf"{re.escape(room)}([./]|$)", name)), key=len, default=None)


def short(module: str) -> str:
    """A module as the table names it: without the name of the package, but for the package itself."""
    return module.removeprefix(f"{PACKAGE}.")


def python_parts() -> dict[str, set[str]]:
    """Every module of the package, and the modules that it imports, as the table names them."""
    return {short(NATIVE): set()} | {short(each): {short(other) for other in imported(each)} for each in modules()}


def native_parts() -> dict[str, set[str]]:
    """Every file of the native core, and the files of it that it includes; paths from the root."""
    files = [path for path in (ROOT / "csrc").rglob("*.*") if path.suffix in {".h", ".cpp", ".cu"}]
    return {
        path.relative_to(ROOT).as_posix(): {f"csrc/{name}" for name in _INCLUDE.findall(path.read_text("utf-8"))}
        for path in files
    }


def uses(table: Sequence[Row], parts: dict[str, set[str]]) -> dict[str, dict[str, list[str]]]:
    """Room to the rooms that it really uses, each with the parts that do so."""
    rooms = [room for row in table for room in row.rooms]
    found: dict[str, dict[str, list[str]]] = {room: {} for room in rooms}
    for part, others in parts.items():
        own = room_of(part, rooms)
        for other in sorted(others):
            there = room_of(other, rooms)
            if own is not None and there not in (own, None):
                found[own].setdefault(str(there), []).append(part)
    return found
