"""Pages that print figures: blocks of text that are made from records, and figures that are typed in, which are listed.

A block stands between `<!-- record:RECORD/VIEW -->` and `<!-- end -->`; `records/views.py` makes its text. Where a
record is missing, the block keeps the text that it has. Between `<!-- history -->` and `<!-- end -->` stands what
was measured with code or weights that are gone: it is true of its time, and nothing can make it again.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from records.code import ROOT
from records.record import FOLDER

WHOLE: Mapping[str, str] = {
    "docs/results.md": "results-whole",
    "docs/paper-figures.md": "results-models",
    "docs/figure-7.md": "figure-7",
    "benchmarks/RESULTS-commands.md": "commands",
    "benchmarks/RESULTS-uastc.md": "uastc",
    "benchmarks/engines/RESULTS.md": "engines-three",
    "benchmarks/engines/RESULTS-cycles.md": "engines-cycles",
}
"""Pages that are made from a record as a whole."""

LIST = FOLDER / "unrecorded.json"

_BLOCK = re.compile(r"(?<!`)(<!-- record:(\S+) -->)(\n?)(.*?)(\n *|)(<!-- end -->)", re.DOTALL)
_HISTORY = re.compile(r"<!-- history -->.*?<!-- end -->", re.DOTALL)
_DOCSTRING = re.compile(r"<!-- (?:docstring|file): \S+ -->.*?<!-- end -->", re.DOTALL)
_CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
_UNITS = "dB|%|ms|ns|s|seconds|minutes|MiB|GiB|MB|GB|degrees|times"
_NUMBER = r"(?<![\w.])[-+]?\d+(?:,\d{3})*(?:\.\d+)?"
_FIGURE = re.compile(rf"{_NUMBER} (?:{_UNITS})(?!\w)|{_NUMBER}%")
_CELL = re.compile(rf"{_FIGURE.pattern}|(?<![\w.])[-+]?\d+\.\d+")
"""Figures in sentences have a unit; figures in tables may have a fraction and no unit."""


def pages(root: Path = ROOT) -> list[str]:
    """Markdown files that may hold figures of ours, relative to the root. What other people's engines do is theirs, and
    cards of weights are made when weights are exported."""
    found = [
        root / "README.md",
        *(p for folder in ("docs", "examples", "benchmarks") for p in (root / folder).rglob("*.md")),
    ]
    names = (path.relative_to(root).as_posix() for path in found if "node_modules" not in path.parts)
    return sorted(name for name in names if not name.startswith("docs/engines/"))


def cards(root: Path = ROOT) -> list[str]:
    """Cards of released weights, relative to the root: what an export wrote, and blocks below it."""
    return sorted(path.relative_to(root).as_posix() for path in (root / "models" / "weights").glob("*.md"))


def blocks(text: str) -> list[str]:
    """Names of the blocks of a page."""
    return [found[2] for found in _BLOCK.finditer(text)]


def filled(text: str, made: Callable[[str], str | None]) -> str:
    """A page with its blocks renewed; those for which there is None stay as they are."""

    def renew(found: re.Match[str]) -> str:
        opening, name, before, _, after, closing = found.groups()
        new = made(name)
        return found[0] if new is None else f"{opening}{before}{new}{after}{closing}"

    return _BLOCK.sub(renew, text)


def typed(text: str) -> list[str]:
    """Figures that stand in a page outside of blocks, in their order."""
    for gone in (_BLOCK, _HISTORY, _DOCSTRING, _CODE):
        text = gone.sub(" ", text)
    rows = ((_CELL if line.lstrip().startswith("|") else _FIGURE, line) for line in text.splitlines())
    return [found[0] for pattern, line in rows for found in pattern.finditer(line)]


@dataclass(frozen=True)
class Unrecorded:
    """What is printed without a record, by name, so that nobody forgets; the file is
    benchmarks/records/unrecorded.json.

    Args:
        records: that nobody has measured yet.
        figures: of a page, typed in, that shall come from a record or go.
        given: of a page, typed in, that nobody of this project measured: limits, settings, figures of other people.
    """

    records: list[str] = field(default_factory=list)
    figures: Mapping[str, list[str]] = field(default_factory=dict)
    given: Mapping[str, list[str]] = field(default_factory=dict)


def unrecorded(path: Path = LIST) -> Unrecorded:
    return Unrecorded(**json.loads(path.read_text(encoding="utf-8")))


def save(listed: Unrecorded, path: Path = LIST) -> None:
    """Writes the list, a page a line."""
    parts = [f' "records": {json.dumps(listed.records)}']
    for name, found in (("figures", listed.figures), ("given", listed.given)):
        rows = [f"  {json.dumps(page)}: {json.dumps(each)}" for page, each in sorted(found.items()) if each]
        parts.append(f' "{name}": {{\n' + ",\n".join(rows) + "\n }")
    path.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")


def unlisted(listed: Unrecorded, root: Path = ROOT) -> Iterator[tuple[str, list[str]]]:
    """Page and the typed figures in it that the list does not have."""
    for page in pages(root):
        if page not in WHOLE:
            more = Counter(typed((root / page).read_text(encoding="utf-8")))
            more.subtract([*listed.figures.get(page, []), *listed.given.get(page, [])])
            found = sorted((+more).elements())
            if found:
                yield page, found


def shrunk(listed: Unrecorded, missing: list[str], root: Path = ROOT) -> Unrecorded:
    """The list without records that were measured and without figures that pages do not have any more."""
    there = {
        page: Counter(typed((root / page).read_text(encoding="utf-8"))) for page in pages(root) if page not in WHOLE
    }

    def left(kept: Mapping[str, list[str]]) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for page, figures in kept.items():
            for figure in figures:
                if there.get(page, Counter())[figure] > 0:
                    there[page][figure] -= 1
                    found.setdefault(page, []).append(figure)
        return found

    given = left(listed.given)
    return Unrecorded([name for name in listed.records if name in missing], left(listed.figures), given)


def grown(listed: Unrecorded, named: Sequence[str], root: Path = ROOT) -> Unrecorded:
    """The list with the figures of pages that it does not have, as given: people look at them before they say so."""
    more = {page: figures for page, figures in unlisted(listed, root) if page in named}
    given = {page: [*listed.given.get(page, []), *more.get(page, [])] for page in {*listed.given, *more}}
    return replace(listed, given=dict(sorted(given.items())))
