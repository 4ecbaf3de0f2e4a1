"""Arrows between rooms point one way, no modules import each other in a circle, and the page that lists the rooms says
what the code does."""

from __future__ import annotations

import re
import subprocess
import sys
from graphlib import TopologicalSorter

import pytest

from .source_tree import NATIVE, PACKAGE, ROOT, imported, imports, modules

PAGE = ROOT / "docs" / "architecture.md"
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
TORCH_ALLOWED = re.compile(
    r"mipbake\.(models|training)\b|mipbake\.(shading|sampling|raster|stochastic)\.(ops|reference)$|mipbake\.raster\._device$"
)
DOORS = ("mipbake.shading", "mipbake.sampling", "mipbake.raster", "mipbake.stochastic")


def table(verb: str) -> dict[str, set[str]]:
    """Rooms of the page to those that they may import or include, from the lowest to the highest."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    first = lines.index(f"| room | what lives there | may {verb} |") + 2
    rows = {}
    for line in lines[first : lines.index("", first)]:
        rooms, _, may = line.strip("|").split(" | ")
        rows |= {room: set(re.findall(r"`([^`]+)`", may)) for room in re.findall(r"`([^`]+)`", rooms)}
    return rows


def room_of(module: str) -> str:
    """The folder below the package that a module lies in; of the core and the two packages themselves, their names."""
    return module if module.count(".") == 0 else module.split(".")[1]


def files_of_the_core() -> dict[str, set[str]]:
    """Every file of the native core, and the files of it that it includes; paths from the root."""
    files = [path for path in (ROOT / "csrc").rglob("*.*") if path.suffix in {".h", ".cpp", ".cu"}]
    return {
        path.relative_to(ROOT).as_posix(): {f"csrc/{name}" for name in INCLUDE.findall(path.read_text("utf-8"))}
        for path in files
    }


def native_room_of(path: str) -> str:
    return path if path.count("/") == 1 else "/".join(path.split("/")[:2])


def test_the_page_lists_the_rooms_and_what_they_import() -> None:
    used: dict[str, set[str]] = {room_of(NATIVE): set()}
    for module in modules():
        room = room_of(module)
        used.setdefault(room, set()).update({room_of(each) for each in imported(module)} - {room})
    assert used == table("import")


def test_the_page_lists_the_rooms_of_the_core_and_what_they_include() -> None:
    used: dict[str, set[str]] = {}
    for path, others in files_of_the_core().items():
        room = native_room_of(path)
        used.setdefault(room, set()).update({native_room_of(each) for each in others} - {room})
    assert used == table("include")


@pytest.mark.parametrize("verb", ["import", "include"])
def test_rows_name_rows_above_them_alone(verb: str) -> None:
    above: set[str] = set()
    for room, may in table(verb).items():
        assert above >= may, room
        above.add(room)


def test_no_modules_load_each_other_in_a_circle() -> None:
    graph = {module: imported(module, loading=True) - {PACKAGE} for module in modules()}
    TopologicalSorter(graph).prepare()  # CycleError names the circle


def reaches(names: set[str], room: str) -> set[str]:
    return {name for name in names if name == room or name.startswith(room + ".")}


def test_torch_stays_in_its_rooms() -> None:
    for module in (each for each in modules() if not TORCH_ALLOWED.match(each)):
        assert not reaches(set(imports(module, loading=True)), "torch"), module


@pytest.mark.parametrize("module", [f"{door}.reference" for door in DOORS])
def test_twins_import_nothing_native(module: str) -> None:
    arguments = module.replace("reference", "_arguments")
    plain = ("mipbake.base.errors", "mipbake.base.arguments", "mipbake.base.aligned", "mipbake.material", arguments)
    inner = [module, *[arguments] * bool(reaches(set(imports(module)), arguments))]
    assert all(name.startswith(plain) for each in inner for name in reaches(set(imports(each)), "mipbake"))


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
