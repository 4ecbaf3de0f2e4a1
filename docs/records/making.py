"""Pages, and parts of pages, made from records and from docstrings."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from records import docstrings
from records.known import KNOWN
from records.pages import RELEASE, WHOLE, blocks, filled, pages, release
from records.record import FOLDER, ROOT, Missing, Records, load
from records.scripts import script
from records.views import VIEWS
from records.wrapping import wrapped_page

_CHARTS = {"docs/results.md": "results-figure-5-*.svg", "docs/paper-figures.md": "paper-figure-5-*.svg"}
"""Pages to the names of charts beside them, which are there for what was measured."""


def renewed(root: Path = ROOT, folder: Path = FOLDER) -> dict[Path, bytes | None]:
    """Files that are out of step with the records, and what they shall hold: None for those that shall not be there.

    Pages of missing records are left alone.
    """
    records = Records(folder)
    quoting = (root / docstrings.PAGE).read_text(encoding="utf-8")
    made: dict[str, bytes | None] = {docstrings.PAGE: docstrings.fill(quoting).encode()}
    for page in (each for each in pages(root) if each not in made):
        text = (root / page).read_text(encoding="utf-8")
        names = list(dict.fromkeys(name for each in blocks(text) for name in _records(each)))
        words = release(names, records) if names else None
        made[page] = filled(text, lambda name: words if name == RELEASE else block(name, records)).encode()  # noqa: B023
    for page, names in WHOLE.items():
        if load(names[0], folder) is not None:
            made |= _PAGES[page](records)
            made[page] = (made[page] or b"").rstrip() + f"\n\n{release(names, records)}\n".encode()
    for page, charts in _CHARTS.items():  # of methods that are not measured any more
        if load(WHOLE[page][0], folder) is not None:
            made |= {f"docs/{old.name}": None for old in (root / "docs").glob(charts) if f"docs/{old.name}" not in made}
    there = {name: (root / name).read_bytes() if (root / name).exists() else None for name in made}
    return {root / name: content for name, content in made.items() if content != there[name]}


def _records(block: str) -> list[str]:
    """Names of the records that a block is made from, as far as its own name tells."""
    name = block.partition("/")[0]
    if block == RELEASE:
        return []
    return [each for each in KNOWN if each.startswith("fitting-")] if name == "fitting" else [name]


def block(name: str, records: Records) -> str | None:
    """The text of a block; None where one of the records that it is made from is missing."""
    try:
        return VIEWS[name](records)
    except Missing:
        return None


def _charted(module: str, name: str) -> Callable[[Records], Mapping[str, bytes]]:
    """A page that a module of `benchmarks` makes, with its charts."""

    def made(records: Records) -> Mapping[str, bytes]:
        page = script("benchmarks", module)
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / name
            path.write_text(page.text(records.folder, path), encoding="utf-8")
            return {f"docs/{each.name}": each.read_bytes() for each in Path(scratch).iterdir()}

    return made


def _figure_7(records: Records) -> Mapping[str, bytes]:
    return {"docs/figure-7.md": script("docs", "make_figure_7").page_of(records["figure-7"], "figure-7").encode()}


def _from(folder: str, file: str, name: str, page: str) -> Callable[[Records], Mapping[str, bytes]]:
    return lambda records: {page: wrapped_page(script(folder, file).page_of(records[name])).encode()}


_PAGES: Mapping[str, Callable[[Records], Mapping[str, bytes]]] = {
    "docs/results.md": _charted("results_page.page", "results.md"),
    "docs/paper-figures.md": _charted("paper_page.page", "paper-figures.md"),
    "docs/figure-7.md": _figure_7,
    "benchmarks/RESULTS-commands.md": _from("benchmarks", "commands", "commands", "benchmarks/RESULTS-commands.md"),
    "benchmarks/RESULTS-uastc.md": _from("benchmarks", "uastc", "uastc", "benchmarks/RESULTS-uastc.md"),
    "benchmarks/engines/RESULTS.md": _from(
        "benchmarks/engines", "three_table", "engines-three", "benchmarks/engines/RESULTS.md"
    ),
    "benchmarks/engines/RESULTS-cycles.md": _from(
        "benchmarks/engines", "cycles_proof", "engines-cycles", "benchmarks/engines/RESULTS-cycles.md"
    ),
}
