"""Arrows between rooms point one way, and the page that lists the rooms says what the code does."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs"))
try:
    table = importlib.import_module("rooms.table")
    modules, imports = (getattr(importlib.import_module("rooms.imports"), name) for name in ("modules", "imports"))
finally:
    sys.path.remove(str(ROOT / "docs"))

TABLES = {"import": table.python_parts(), "include": table.native_parts()}

DOORS = ("mipbake.shading", "mipbake.sampling", "mipbake.raster", "mipbake.stochastic")
TORCH_ALLOWED = re.compile(
    r"mipbake\.(models|training)\b|mipbake\.(shading|sampling|raster|stochastic)\.(ops|reference)$|mipbake\.raster\._device$"
)


@pytest.mark.parametrize("verb", TABLES)
def test_every_file_lies_in_a_room(verb: str) -> None:
    rooms, parts = [room for row in table.rows(verb) for room in row.rooms], TABLES[verb]
    assert len(rooms) == len(set(rooms)) > 7
    assert {part for part in parts if table.room_of(part, rooms) is None} == set()
    assert set(rooms) == {table.room_of(part, rooms) for part in parts}


@pytest.mark.parametrize("verb", TABLES)
def test_a_room_imports_what_its_row_says(verb: str) -> None:
    found = table.uses(table.rows(verb), TABLES[verb])
    for row in table.rows(verb):
        for room in row.rooms:
            made = {other: parts for other, parts in found[room].items() if other != table.EVERYWHERE}
            assert set(made) <= set(row.may), f"{room}: {made}"


@pytest.mark.parametrize("verb", TABLES)
def test_rows_name_rows_above_them_alone(verb: str) -> None:
    above: set[str] = set()
    for row in table.rows(verb):
        assert above.issuperset(row.may), row
        above.update(row.rooms)


def reaches(names: set[str], room: str) -> set[str]:
    return {name for name in names if name == room or name.startswith(room + ".")}


def test_torch_stays_in_its_rooms() -> None:
    for module in (each for each in modules() if not TORCH_ALLOWED.match(each)):
        assert not reaches(imports(module, loading=True), "torch"), module


@pytest.mark.parametrize("module", [f"{door}.reference" for door in DOORS])
def test_twins_import_nothing_native(module: str) -> None:
    arguments = module.replace("reference", "_arguments")
    plain = ("mipbake.base.errors", "mipbake.material", arguments)
    for inner in {module, arguments} & set(modules()):
        assert all(name.startswith(plain) for name in reaches(imports(inner), "mipbake"))


def test_one_piece_of_code_finds_the_stream() -> None:
    for module, path in modules().items():
        found = "cuda.current_stream" in path.read_text(encoding="utf-8")
        assert found == (module == "mipbake.base.stream"), module


def test_the_entry_point_loads_nothing_before_it_handles_signals() -> None:
    assert imports("mipbake_start", loading=True) <= {"__future__.annotations", "os", "signal"}
    assert 'mipbake = "mipbake_start:run"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_native_core_knows_no_python() -> None:
    for path in (ROOT / "csrc").rglob("*.*"):
        text = path.read_text(encoding="utf-8")
        if path.parent.name != "bind":
            assert not re.search(r"nanobind|Python\.h|torch/", text), path


def test_importing_the_library_loads_nothing_heavy() -> None:
    heavy = "torch", "OpenImageIO", "OpenEXR", "colour", "skimage", "flip_evaluator"
    script = f"import sys, mipbake; print([m for m in {heavy!r} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
