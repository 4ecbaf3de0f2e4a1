"""Modules of the package, where they lie in a checkout, and what each imports, read from their syntax trees."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "mipbake"
NATIVE = f"{PACKAGE}._native"
"""The compiled core, which has no file of Python."""


@cache
def folders() -> Mapping[str, str]:
    """Dotted names of packages to their folders, relative to ROOT, as pyproject.toml tells the build. Of two that have
    a module, the later one counts."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages: Mapping[str, str] = settings["tool"]["scikit-build"]["wheel"]["packages"]
    return {name.replace("/", "."): folder for name, folder in packages.items()}


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name, but the compiled core."""
    found = {}
    for package, folder in folders().items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = [part for part in path.relative_to(ROOT / folder).with_suffix("").parts if part != "__init__"]
            found[path] = ".".join([package, *parts])
    return {name: path for path, name in found.items()}


@cache
def imports(module: str, loading: bool = False) -> frozenset[str]:
    """Dotted names that a module imports, of any package.

    Args:
        module: its name.
        loading: only what it imports when it is loaded. Otherwise an import counts wherever it stands: in a function,
            and for types alone.
    """
    tree = ast.parse(modules()[module].read_text(encoding="utf-8"))
    names = set()
    for node in _loaded(tree) if loading else ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module and not node.level, f"{module} imports relatively"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def _loaded(node: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        later = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        if not later and not (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)):
            yield child
            yield from _loaded(child)


def imported(module: str, loading: bool = False) -> set[str]:
    """Modules of the package that a module imports. A name that is no module belongs to the module that has it."""
    found = set()
    for name in imports(module, loading):
        while name and name not in modules() and name != NATIVE:
            name = name.rpartition(".")[0]  # noqa: PLW2901
        found |= {name} - {"", module}
    return found
