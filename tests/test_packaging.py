"""What the build installs is what the checkout holds, and what it requires is what the code imports."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import metadata

import pytest

from mipbake.base.extras import EXTRAS

from .source_tree import ROOT, imported, modules, tomllib

ROOMS = {
    "mipbake/": "mipbake",
    "mipbake/models/": "models",
    "mipbake/training/": "training",
    "mipbake/cli/": "cli",
    "mipbake/page/": "web/page",
    "mipbake_start/": "cli/mipbake_start",
}


def test_the_wheel_holds_every_module_config_and_weight() -> None:
    try:
        files = metadata.files("mipbake")
    except metadata.PackageNotFoundError:
        pytest.skip("mipbake is not installed: it runs from the checkout")
    installed = {str(path) for path in files}
    kinds = {".py", ".pyi", ".toml", ".safetensors", ".json", ".md", ".typed", ".cmake", ".js", ".html", ".css", ".svg"}
    rooms = {ROOT / folder for folder in ROOMS.values()}
    expected = {
        f"{prefix}{path.relative_to(ROOT / folder).as_posix()}"
        for prefix, folder in ROOMS.items()
        for path in (ROOT / folder).rglob("*")
        if path.suffix in kinds and "__pycache__" not in path.parts
        # A file belongs to the innermost room that it is in.
        if next(parent for parent in path.parents if parent in rooms) == ROOT / folder
    }
    assert expected - installed == set()
    assert any(name.startswith("mipbake/_native") and not name.endswith(".pyi") for name in installed)


COMMANDS = ("bake", "validate", "inspect", "info", "convert", "presets")
"""Commands that work with the base install. `compare` is not among them."""

RARE = {"torch"}
"""What commands import without `extra` around it, for networks of architectures that the native core does not have. The
command line says what to type where it is missing, and tests/test_extras.py bakes without it."""

NEWER = {"compression"}
"""What only newer versions of Python have in their standard library."""


def requirements(extra: str | None = None) -> set[str]:
    """Distributions that pyproject.toml requires, by their names in lower case."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = project["dependencies"] if extra is None else project["optional-dependencies"][extra]
    return {re.split(r"[^\w.-]", line)[0].lower() for line in lines}


@cache
def reachable() -> frozenset[str]:
    """Modules of the package that the commands import, directly or not, inside functions as well."""
    todo, seen = ["mipbake_start", "mipbake.cli.main", *(f"mipbake.cli.{name}" for name in COMMANDS)], set()
    while todo:
        module = todo.pop()
        if module not in seen and module in modules():
            seen.add(module)
            todo += imported(module)
    return frozenset(seen)


def foreign(tree: ast.AST, extra: str = "") -> Iterator[tuple[str, str]]:
    """Each module of another project that is imported, by its first name, with the extra that stands around it. What
    is imported for types alone is left out."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        within = extra
        if isinstance(node, ast.With):
            told = re.findall(r"\bextra\('(\w+)'", ast.unparse(node).partition("\n")[0])
            within = told[0] if told else extra
        if isinstance(node, ast.Try) and any(h.type and "ImportError" in ast.unparse(h.type) for h in node.handlers):
            within = within or "any"
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        for name in (name.partition(".")[0] for name in names):
            if name not in sys.stdlib_module_names | NEWER | {"mipbake", "mipbake_start"}:
                yield name, within
        yield from foreign(node, within)


def wanted(found: Iterable[str]) -> dict[tuple[str, str], set[str]]:
    """What modules import, and for which extra, to the modules that do."""
    uses: dict[tuple[str, str], set[str]] = {}
    for module in found:
        for use in foreign(ast.parse(modules()[module].read_text(encoding="utf-8"))):
            uses.setdefault(use, set()).add(module)
    return uses


def lacking(found: Iterable[str], base: set[str]) -> dict[str, set[str]]:
    """Distributions that modules import without an extra and that are not in the base, to the modules that do."""
    distributions = metadata.packages_distributions()
    lacked: dict[str, set[str]] = {}
    for (name, extra), users in wanted(found).items():
        names = {each.lower() for each in distributions.get(name, [name])}
        if not extra and not names & (base | RARE):
            lacked.setdefault(name, set()).update(users)
    return lacked


@pytest.mark.long
def test_the_base_install_has_what_the_commands_import() -> None:
    assert lacking(reachable(), requirements()) == {}


def test_extras_bring_what_is_asked_of_them() -> None:
    for name, packages in EXTRAS.items():
        assert {each.lower() for each in packages.values()} <= requirements(name), name
    for (module, extra), users in wanted(reachable()).items():
        if extra:
            known = EXTRAS.values() if extra == "any" else [EXTRAS[extra]]
            assert any(module in packages for packages in known), (module, users)
