"""Numbers that were chosen say how: where they were measured, who gave them, or that they are a guess."""

from __future__ import annotations

import ast
import re
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
ROOMS = ("mipbake/judging", "mipbake/prefilter", "mipbake/reference", "mipbake/compare", "models", "training")
FILES = ("mipbake/io/gltf/ranges.py", *(f"mipbake/{name}.py" for name in ("glb", "glb_plain", "glb_stacks")))

TUNED = r"guess|measured|benchmarks/|docs/research\.md|equation|section|\b(19|20)\d\d\b|'s own number"
OTHER = r"not tuned|\bseeds?\b|random numbers of their own|\bcache\b|specification|root|extension"
"""What else a number may be: nobody could choose another one and bake something better."""

NUMBERS = (ast.Constant, ast.Tuple, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop, ast.Name, ast.expr_context)


def _is_number(value: ast.expr | None) -> bool:
    """Whether a value is written as numbers, with others' names among them or not."""
    nodes = [] if value is None else list(ast.walk(value))
    given = [node.value for node in nodes if isinstance(node, ast.Constant)]
    return all(isinstance(node, NUMBERS) for node in nodes) and any(type(each) in (int, float) for each in given)


def _said(lines: list[str], statement: ast.stmt, follows: ast.stmt | None) -> str:
    """The comments on and above a statement, and its docstring."""
    first, last = statement.lineno - 1, statement.end_lineno or statement.lineno
    while first and lines[first - 1].startswith("#"):
        first -= 1
    text = follows.value if isinstance(follows, ast.Expr) else None
    doc = str(text.value) if isinstance(text, ast.Constant) else ""
    return " ".join(" ".join([*(line.partition("#")[2] for line in lines[first:last]), doc]).split())


def test_every_number_says_where_it_comes_from() -> None:
    silent = []
    for path in sorted([*(p for room in ROOMS for p in (PACKAGE / room).rglob("*.py")), *(PACKAGE / f for f in FILES)]):
        source = path.read_text(encoding="utf-8")
        lines, body = source.splitlines(), ast.parse(source).body
        for statement, follows in zip(body, [*body[1:], None], strict=True):
            if not isinstance(statement, ast.Assign | ast.AnnAssign) or not _is_number(statement.value):
                continue
            if not re.search(f"{TUNED}|{OTHER}", _said(lines, statement, follows), re.IGNORECASE):
                silent.append(f"{path.relative_to(PACKAGE)}:{statement.lineno}: {lines[statement.lineno - 1]}")
    assert not silent, "\n".join(["say who measured these numbers, or that they are a guess:", *silent])
