"""Numbers that were chosen say how: where they were measured, who gave them, or that they are a guess."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1]
ROOMS = ("mipbake/judging", "mipbake/prefilter", "mipbake/reference", "mipbake/compare", "models", "training")
FILES = tuple(
    f"mipbake/{name}.py"
    for name in (
        "adjust", "directions", "glb", "glb_plain", "glb_stacks", "pixel_filter", "specular_glossiness",
        "io/archives", "io/decode", "io/gltf/ranges", "io/ktx2", "io/normal", "io/steep",
        "metrics/flicker", "metrics/snr",
    )
)  # fmt: skip
"""Files with numbers that somebody could have chosen otherwise, outside of the rooms where most numbers are."""

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


def _neutral(value: ast.expr | None) -> bool:
    """Whether a value is made of zeros and ones alone: nothing, or things as they are."""
    given = [node.value for node in ast.walk(value) if isinstance(node, ast.Constant)] if value else []
    return all(each in (0, 1) for each in given)


def _in_docstring(text: str, field: str) -> str:
    """What the docstring of a class says about a field, and about all its fields: what is not under `Args`."""
    about, _, rest = text.partition("\nArgs:\n")
    listed, _, after = rest.partition("\n\n")
    entries = re.split(r"\n {4}(?! )", f"\n{listed}")
    own = [each for each in entries if re.search(rf"(^|[ ,.]){field}(, \w+)*: ", " ".join(each.split()))]
    return " ".join([about, *own, after])


def unsaid(source: str) -> list[int]:
    """Lines with numbers that say nothing about where they come from: of modules, and defaults of fields of records."""
    lines, tree = source.splitlines(), ast.parse(source)
    found = []
    records = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    for body, doc in [(tree.body, None), *((each.body, ast.get_docstring(each) or "") for each in records)]:
        for statement, follows in zip(body, [*body[1:], None], strict=True):
            if not isinstance(statement, ast.Assign | ast.AnnAssign) or not _is_number(statement.value):
                continue
            said = _said(lines, statement, follows)
            if doc is not None:
                if _neutral(statement.value):
                    continue
                name = statement.target if isinstance(statement, ast.AnnAssign) else statement.targets[0]
                said += " " + _in_docstring(doc, ast.unparse(name))
            if not re.search(f"{TUNED}|{OTHER}", said, re.IGNORECASE):
                found.append(statement.lineno)
    return found


def test_every_number_says_where_it_comes_from() -> None:
    silent = []
    for path in sorted([*(p for room in ROOMS for p in (PACKAGE / room).rglob("*.py")), *(PACKAGE / f for f in FILES)]):
        source = path.read_text(encoding="utf-8")
        silent += [f"{path.relative_to(PACKAGE)}:{at}: {source.splitlines()[at - 1]}" for at in unsaid(source)]
    assert not silent, "\n".join(["say who measured these numbers, or that they are a guess:", *silent])


RECORD = '''
class Effort:
    """How much.

    Args:
        groups: of pairs{groups}.
        points, samples: in each{points}.
    {all}"""

    groups: int = 32
    points: int = 64
    on: int = 1
'''


@pytest.mark.parametrize(
    ("said", "lines"),
    [
        ({}, [10, 11]),
        ({"groups": "; a guess"}, [11]),
        ({"points": "; a guess"}, [10]),
        ({"all": "\n    The numbers are guesses.\n    "}, []),
    ],
)
def test_defaults_of_fields_are_numbers_too(said: dict[str, str], lines: list[int]) -> None:
    assert unsaid(RECORD.format(**{"groups": "", "points": "", "all": "", **said})) == lines
    assert unsaid("LEAST = 0.25  # of a texel\n") == [1]
