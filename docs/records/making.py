"""Pages, and parts of pages, made from records."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from records.known import KNOWN
from records.pages import RELEASE, blocks, filled, pages, release
from records.record import FOLDER, ROOT, Missing, Records
from records.scripts import script
from records.views import VIEWS
from records.wrapping import wrapped_page

_CHARTS = {"docs/results.md": "results-figure-5-*.svg", "docs/paper-figures.md": "paper-figure-5-*.svg"}
"""Pages to the names of charts beside them, which are there for what was measured."""

_FILE = re.compile(r"(<!-- file: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
"""A block that quotes a file."""


def renewed(root: Path = ROOT, folder: Path = FOLDER) -> dict[Path, bytes | None]:
    """Files that are out of step with the records, and what they shall hold: None for those that shall not be there.

    Pages of missing records are left alone.
    """
    records = Records(folder)
    made: dict[str, bytes | None] = {}
    for page in pages(root):
        text = _FILE.sub(lambda found: _quoted(root, *found.groups()), (root / page).read_text(encoding="utf-8"))
        parts = {name: block(name, records) for name in blocks(text) if name != RELEASE}
        names = dict.fromkeys(each for name, part in parts.items() if part is not None for each in _records(name))
        if parts:
            parts[RELEASE] = release([*names], records)
        made[page] = filled(text, parts.get).encode()
    for page, (names, whole) in _WHOLE.items():
        try:
            records[names[0]]
        except Missing:
            continue
        made |= whole(records)
        made[page] = (made[page] or b"").rstrip() + f"\n\n{release(names, records)}\n".encode()
        for old in (root / "docs").glob(_CHARTS.get(page, "nothing")):
            made.setdefault(f"docs/{old.name}", None)  # of a method that is not measured any more
    there = {name: (root / name).read_bytes() if (root / name).exists() else None for name in made}
    return {root / name: content for name, content in made.items() if content != there[name]}


def _quoted(root: Path, opening: str, name: str, closing: str) -> str:
    return f"{opening}```python\n{(root / name).read_text(encoding='utf-8').strip()}\n```\n{closing}"


def _records(block: str) -> list[str]:
    """Names of the records that a block is made from, as far as its own name tells."""
    name = block.partition("/")[0]
    return [each for each in KNOWN if each.startswith("fitting-")] if name == "fitting" else [name]


def block(name: str, records: Records) -> str | None:
    """The text of a block; None where one of the records that it is made from is missing."""
    try:
        return VIEWS[name](records)
    except Missing:
        return None


Made = Callable[[Records], Mapping[str, bytes]]
"""Records to a page, and charts beside it: paths relative to the root, and what they hold."""


def _charted(module: str, name: str) -> Made:
    """A page that a module of `benchmarks` makes, with its charts."""

    def made(records: Records) -> Mapping[str, bytes]:
        page = script("benchmarks", module)
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / name
            path.write_text(page.text(records.folder, path), encoding="utf-8")
            return {f"docs/{each.name}": each.read_bytes() for each in Path(scratch).iterdir()}

    return made


def _from(folder: str, file: str, name: str, page: str) -> tuple[Sequence[str], Made]:
    """A page that `page_of` of a script makes of one record."""
    return (name,), lambda records: {page: wrapped_page(script(folder, file).page_of(records[name])).encode()}


_RESULTS = ("results-whole", "results-crop", "results-directional", "aims")
_PAPER = ("results-models", "results-correlated", "paper-pictures", "constant-materials")
_ENGINES = "benchmarks/engines"
_WHOLE: Mapping[str, tuple[Sequence[str], Made]] = {
    "docs/results.md": (_RESULTS, _charted("results_page.page", "results.md")),
    "docs/paper-figures.md": (_PAPER, _charted("paper_page.page", "paper-figures.md")),
    "docs/figure-7.md": _from("docs", "make_figure_7", "figure-7", "docs/figure-7.md"),
    "benchmarks/RESULTS-commands.md": _from("benchmarks", "commands", "commands", "benchmarks/RESULTS-commands.md"),
    "benchmarks/RESULTS-uastc.md": _from("benchmarks", "uastc", "uastc", "benchmarks/RESULTS-uastc.md"),
    f"{_ENGINES}/RESULTS.md": _from(_ENGINES, "three_table", "engines-three", f"{_ENGINES}/RESULTS.md"),
    f"{_ENGINES}/RESULTS-cycles.md": _from(_ENGINES, "cycles_proof", "engines-cycles", f"{_ENGINES}/RESULTS-cycles.md"),
}
"""Pages that are made from records as a whole: the records, of which the first must be there, and what makes them."""
