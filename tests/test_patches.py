"""Tests replace what a library offers, or hand in an argument: no test hangs on a private name of this project.

Private modules are names of rooms, and tests import them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent / "mipbake"
REPLACING = re.compile(r"(^|\.)(setattr|delattr|setitem|delitem|patch|patch\.(object|multiple|dict))$")
"""Methods of monkeypatch, functions of unittest.mock, and the built-in ones."""

IN_A_PROGRAM = re.compile(r"(\w+\._\w+)\s*=[^=]|setattr\((\w+), '(_\w+)'")
"""An assignment in a program that a test has as a string."""


def private(name: str) -> bool:
    return any(part.startswith("_") for part in name.split("."))


def owner(node: ast.expr) -> str:
    """`module` of `package.module`, and of `module`."""
    return ast.unparse(node).rpartition(".")[2]


def called(node: ast.Call) -> Iterator[str]:
    """What a call replaces, where that is private. A name that is in a variable is not seen."""
    function = ast.unparse(node.func)
    if not REPLACING.search(function) or not node.args:
        return
    target, *rest = node.args
    if isinstance(target, ast.Constant):
        names = [str(target.value)]
    elif function.endswith(("item", "dict")):
        names = [f"{owner(target.value)}.{target.attr}"] if isinstance(target, ast.Attribute) else [owner(target)]
    else:
        given = [each.value for each in rest[:1] if isinstance(each, ast.Constant)]
        names = [f"{owner(target)}.{name}" for name in (*given, *(each.arg for each in node.keywords))]
    yield from (name for name in names if private(name))


def assigned(node: ast.AST) -> Iterator[str]:
    """Attributes of modules and of other objects that a statement sets or deletes, where they are private."""
    targets = getattr(node, "targets", [getattr(node, "target", None)])
    if isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign | ast.Delete):
        for each in (part for target in targets for part in ast.walk(target)):
            if isinstance(each, ast.Attribute) and each.attr.startswith("_") and owner(each.value) != "self":
                yield f"{owner(each.value)}.{each.attr}"


def replaced(source: str) -> list[str]:
    """The private names that a test replaces."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            found += called(node)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += [one or f"{two}.{three}" for one, two, three in IN_A_PROGRAM.findall(node.value)]
        else:
            found += assigned(node)
    return found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('monkeypatch.setattr(publish, "_exchanged", lambda: None)', "publish._exchanged"),
        ('monkeypatch.setattr("mipbake.base.publish._exchanged", None)', "mipbake.base.publish._exchanged"),
        ('monkeypatch.setattr("mipbake._native.texture", None)', "mipbake._native.texture"),
        ('monkeypatch.setattr(Stages, "__call__", None)', "Stages.__call__"),
        ('monkeypatch.delattr(io.publish, "_exchanged")', "publish._exchanged"),
        ('monkeypatch.setitem(publish._KNOWN, "name", None)', "publish._KNOWN"),
        ('with mock.patch.object(publish, "_exchanged"): pass', "publish._exchanged"),
        ('mock.patch.multiple(publish, _exchanged=None)', "publish._exchanged"),
        ('setattr(publish, "_exchanged", None)', "publish._exchanged"),
        ("publish._exchanged = None", "publish._exchanged"),
        ("first, io.publish._exchanged = None, None", "publish._exchanged"),
        ("""program = "import publish; publish._exchanged = None" """, "publish._exchanged"),
        ("self._names = publish._exchanged", ""),
        ('monkeypatch.setattr(os, "replace", None)', ""),
        ('assert publish._exchanged == "a"', ""),
    ],
)  # fmt: skip
def test_every_way_to_replace_a_name_is_seen(source: str, found: str) -> None:
    assert replaced(source) == ([found] if found else [])


@pytest.mark.long
def test_no_private_name_is_replaced() -> None:
    found: dict[str, list[str]] = {}
    for path in sorted(TESTS.rglob("*.py")):
        for name in [] if path.name == Path(__file__).name else replaced(path.read_text(encoding="utf-8")):
            found.setdefault(name, []).append(path.relative_to(TESTS).as_posix())
    assert not found, found


# ---- names that are used

GIVEN = {"os._exit"}
"""Private names that a library gives to its users."""

OPERATORS = {"ops"}
"""Modules whose private names torch.library.opcheck takes."""


def used(source: str) -> list[str]:
    """The private names that a test imports, or reads of anything but its own objects."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            names = [each.name for each in node.names if re.match("_[^_]", each.name)]
            found += [name for name in names if not list(ROOT.rglob(f"{name}.py*"))]
        elif isinstance(node, ast.Attribute) and re.match("_[^_]", node.attr):
            of = owner(node.value)
            if of not in {"self", *OPERATORS} and f"{of}.{node.attr}" not in GIVEN:
                found.append(f"{of}.{node.attr}")
    return found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from mipbake.base.publish import _exchanged", "_exchanged"),
        ("assert publish._exchanged(a, b)", "publish._exchanged"),
        ("adam = FlatAdam(network)._adam.defaults", "FlatAdam(network)._adam"),
        ("from mipbake.base.stream import current_stream", ""),
        ("from mipbake import _native", ""),
        ("self._names = cls.__name__", ""),
        ("os._exit(1)", ""),
    ],
)
def test_every_use_of_a_private_name_is_seen(source: str, found: str) -> None:
    assert used(source) == ([found] if found else [])


@pytest.mark.long
def test_no_private_name_is_used() -> None:
    found = {path.relative_to(TESTS).as_posix(): used(path.read_text("utf-8")) for path in sorted(TESTS.rglob("*.py"))}
    assert {path: names for path, names in found.items() if names} == {}
