"""Arrows between rooms point one way (docs/architecture.md)."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = {"mipbake": ROOT / "mipbake", "mipbake.models": ROOT / "models", "mipbake.training": ROOT / "training"}
ROOMS["mipbake.cli"] = ROOT / "cli"
"""Where the modules of a package lie in a checkout: no editable install tells, as .ci/typecheck.py says."""

DOORS = ("mipbake.shading", "mipbake.sampling", "mipbake.raster")
TORCH_ALLOWED = re.compile(
    r"mipbake\.(models|training)\b|mipbake\.(shading|sampling|raster)\.(ops|reference)$|mipbake\.raster\._device$"
    # Gradients by texels; blending.py and stages.py import them when they are called.
    r"|mipbake\.prefilter\.search\.(lit_samples|pair_weights|pixel_samples|texel_coordinates|texel_descent)$"
    r"|mipbake\.reference\.lobes$"
)


def modules() -> dict[str, Path]:
    found = {}
    for package, folder in ROOMS.items():
        for path in sorted(folder.rglob("*.py")):
            parts = [p for p in path.relative_to(folder).with_suffix("").parts if p != "__init__"]
            found[".".join([package, *parts])] = path
    return found


def imports(path: Path, module: str, top_level_only: bool = False) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside_functions = {
        id(node)
        for scope in ast.walk(tree)
        if isinstance(scope, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(scope)
    }
    typing_only = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
        for node in ast.walk(block)
    }
    names = set()
    for node in ast.walk(tree):
        if id(node) in typing_only or (top_level_only and id(node) in inside_functions):
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            names |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def reaches(names: set[str], room: str) -> set[str]:
    return {name for name in names if name == room or name.startswith(room + ".")}


@pytest.mark.parametrize("module", modules())
def test_nothing_imports_the_outer_rooms(module: str) -> None:
    names = imports(modules()[module], module)
    for room in ("mipbake.cli", "mipbake.training"):
        if not (module == room or module.startswith(room + ".")):
            assert not reaches(names, room)


@pytest.mark.parametrize("module", modules())
def test_torch_stays_in_its_rooms(module: str) -> None:
    if not TORCH_ALLOWED.match(module):
        assert not reaches(imports(modules()[module], module, top_level_only=True), "torch")


@pytest.mark.parametrize("module", [f"{door}.reference" for door in DOORS])
def test_twins_import_nothing_native(module: str) -> None:
    arguments = module.replace("reference", "_arguments")
    plain = ("mipbake.errors", "mipbake.material", arguments)
    for inner in (module, arguments):
        assert all(name.startswith(plain) for name in reaches(imports(modules()[inner], inner), "mipbake"))


@pytest.mark.parametrize("module", [m for m in modules() if not m.startswith(DOORS)])
def test_the_native_core_has_three_doors(module: str) -> None:
    if module in {"mipbake.cli.version", "mipbake.cli.main", "mipbake._stream"}:
        return
    assert not reaches(imports(modules()[module], module), "mipbake._native")


@pytest.mark.parametrize("module", [m for m in modules() if m.startswith(DOORS)])
def test_doors_are_apart(module: str) -> None:
    """A door of the native core imports none of the others, nor any room that is built on it."""
    own = next(door for door in DOORS if module.startswith(door))
    plain = ("mipbake._aligned", "mipbake._forward_mode", "mipbake.errors", "mipbake.material")
    inner = ("mipbake._native", "mipbake._stream", *plain, own)
    inside = reaches(imports(modules()[module], module), "mipbake") - {"mipbake"}
    assert all(any(reaches({name}, room) for room in inner) for name in inside), inside


def test_one_piece_of_code_finds_the_stream() -> None:
    for module, path in modules().items():
        found = "cuda.current_stream" in path.read_text(encoding="utf-8")
        assert found == (module == "mipbake._stream"), module


def test_reports_stand_on_comparisons_and_these_on_everything_else() -> None:
    """Rooms to the rooms above that they do not import; any other module imports none of the three."""
    compare, report, baking = "mipbake.compare", "mipbake.report", "mipbake.baking"
    above = {
        compare: (report, baking),
        report: (baking,),
        baking: (report,),
        "mipbake.validate": (report, baking),  # it measures as a comparison does
        "mipbake": (report,),  # it brings what measures and what bakes
    }
    for module, path in modules().items():
        if module.startswith(("mipbake.cli", "mipbake.training")):
            continue
        room = next((r for r in above if module == r or (r != "mipbake" and module.startswith(r + "."))), None)
        for outer in above[room] if room else (compare, report, baking):
            assert not reaches(imports(path, module), outer), module


@pytest.mark.parametrize("room", ["metrics", "material", "errors"])
def test_inner_rooms_stay_inside(room: str) -> None:
    for module, path in modules().items():
        if module.startswith(f"mipbake.{room}"):
            inside = reaches(imports(path, module), "mipbake")
            assert all(
                name.startswith(("mipbake.errors", "mipbake._colour_science", "mipbake._srgb", f"mipbake.{room}"))
                for name in inside
            ), (module, inside)


def test_the_reference_stands_below_all_that_use_it() -> None:
    inside = "mipbake.reference"
    below = "mipbake.errors", "mipbake.pixel_filter", "mipbake.sampling", "mipbake.shading", "mipbake.metrics.pairs"
    above = "render", "judging", "prefilter", "models", "training", "compare", "validate"
    for module, path in modules().items():
        names = reaches(imports(path, module), "mipbake") - {"mipbake"}
        if reaches({module}, inside):
            assert all(any(reaches({name}, room) for room in (inside, *below)) for name in names), (module, names)
        elif not any(reaches({module}, f"mipbake.{room}") for room in above):
            assert not any(reaches({name}, inside) for name in names), module


def test_the_entry_point_loads_nothing_before_it_handles_signals() -> None:
    path = ROOT / "cli" / "mipbake_start" / "__init__.py"
    assert imports(path, "start", top_level_only=True) <= {"__future__", "__future__.annotations", "os", "signal"}
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
