"""Messages, docstrings, comments and pages name what they speak of, so that a reader need not look for a noun."""

from __future__ import annotations

import re
import tokenize
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mipbake.cli.tables import remarks
from mipbake.io.sources import DECISIONS, NormalConvention
from mipbake.texture_set import TextureSet

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = "mipbake", "cli", "models", "training"
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in (".", "docs", "examples", "benchmarks", "models", "tests")
    for path in ((ROOT / folder).glob("*.md") if folder == "." else (ROOT / folder).rglob("*.md"))
    if "node_modules" not in path.parts
)
ELLIPTIC = re.compile(r"\b(?:those\s+of|(?<!so )that\s+of|each\s+its|thereof|whereof)\b")
FENCED = re.compile(r"```.*?```", re.DOTALL)


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every string and comment of a Python file, line breaks as blanks."""
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type == tokenize.COMMENT or "STRING" in tokenize.tok_name[token.type]:
                yield token.start[0], " ".join(token.string.split())


@pytest.mark.parametrize("folder", FOLDERS)
def test_nouns_are_repeated(folder: str) -> None:
    found = []
    for path in sorted((ROOT / folder).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        for line, text in texts(path):
            if ELLIPTIC.search(text):
                found.append(f"{name}:{line}: {ELLIPTIC.search(text)[0]}")
    assert not found, "\n".join(["name the thing instead:", *found])


@pytest.mark.parametrize("page", PAGES)
def test_nouns_are_repeated_in_pages(page: str) -> None:
    text = FENCED.sub(lambda code: "\n" * code[0].count("\n"), (ROOT / page).read_text(encoding="utf-8"))
    found = [f"{page}:{text.count(chr(10), 0, each.start()) + 1}: {each[0]}" for each in ELLIPTIC.finditer(text)]
    assert not found, "\n".join(["name the thing instead:", *found])


@pytest.mark.parametrize("decided_by", DECISIONS)
def test_what_decided_the_normal_convention_is_said_in_words(decided_by: str) -> None:
    upright = np.broadcast_to(np.float32([0, 0, 1]), (2, 2, 3))
    texture_set = TextureSet.from_arrays("flat", normal=upright, roughness=0.5, metallic=0.0, base_color=0.5)
    first, *_ = remarks(replace(texture_set, convention=NormalConvention("opengl", decided_by, 0.5)))
    assert first == f"normal convention: opengl, {DECISIONS[decided_by]} (confidence 0.50)"
