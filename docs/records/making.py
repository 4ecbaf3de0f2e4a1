"""Pages made from records, as a whole or block by block, and the cards of released weights.

A block stands between `<!-- record:RECORD/VIEW -->` and `<!-- end -->`; `records/views.py` makes its text. Where a
record is missing, the block keeps the text that it has. The block `<!-- record:release -->` of a page says which
release the figures of the page are of.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from mipbake.models.registry import list_weights
from records.known import EXAMPLES, KNOWN
from records.record import FOLDER, ROOT, Missing, Records, goldens, load
from records.scripts import script
from records.views import VIEWS
from records.wrapping import wrapped

RELEASE = "release"

_BLOCK = re.compile(r"(?<!`)(<!-- record:(\S+) -->)(\n?)(.*?)(\n *|)(<!-- end -->)", re.DOTALL)
_FILE = re.compile(r"(<!-- file: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
"""A block that quotes a file."""

WHOLE: Mapping[str, tuple[str, Sequence[str]]] = {
    "docs/results.md": ("results_page.page", ("results-whole", "results-crop", "results-directional", "aims")),
    "docs/paper-figures.md": (
        "paper_page.page",
        (
            "results-models",
            "results-correlated",
            "paper-pictures",
            "figure-7",
            "constant-materials",
            "causes",
            "mipnet-losses",
        ),
    ),
}
"""Pages that a module of `benchmarks` makes as a whole, with charts beside them, and the records that they show. The
first record must be there."""

_CHARTS = "paper-figure-5-*.svg"


def pages(root: Path = ROOT) -> list[str]:
    """Markdown files that may have blocks, relative to the root."""
    found = [root / "README.md", *(path for folder in ("docs", "examples", "benchmarks", "web") for path in
                                   (root / folder).rglob("*.md"))]  # fmt: skip
    return sorted(path.relative_to(root).as_posix() for path in found if "node_modules" not in path.parts)


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
    for page, (module, names) in WHOLE.items():
        if load(names[0], folder) is None:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / Path(page).name
            text = script("benchmarks", module).text(folder, path)
            made |= {f"docs/{chart.name}": chart.read_bytes() for chart in Path(scratch).iterdir()}
        made[page] = f"{text.rstrip()}\n\n{release(names, records)}\n".encode()
    made |= {path: text.encode() for path, text in _cards(root, folder)}
    for old in (root / "docs").glob(_CHARTS):
        made.setdefault(f"docs/{old.name}", None)  # of a method that is not measured any more
    there = {name: (root / name).read_bytes() if (root / name).exists() else None for name in made}
    return {root / name: content for name, content in made.items() if content != there[name]}


def _cards(root: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Cards of released weights, relative to the root, with the validations of the record `cards`."""
    record = load("cards", folder)
    if record is None:
        return
    cards = script("benchmarks", "cards")
    for info in list_weights(root / "models" / "weights"):
        path = f"models/weights/{info.name}.md"
        yield path, cards.text(info, record.data, (root / path).read_text(encoding="utf-8"))


def _quoted(root: Path, opening: str, name: str, closing: str) -> str:
    return f"{opening}```python\n{(root / name).read_text(encoding='utf-8').strip()}\n```\n{closing}"


def _records(block: str) -> list[str]:
    """Names of the records that a block is made from, as far as its own name tells."""
    name = block.partition("/")[0]
    return [each for each in KNOWN if each.startswith(f"{name}-")] if name in EXAMPLES else [name]


def block(name: str, records: Records) -> str | None:
    """The text of a block; None where one of the records that it is made from is missing."""
    try:
        return VIEWS[name](records)
    except Missing:
        return None


def release(names: Sequence[str], records: Records, today: Mapping[str, str] | None = None) -> str:
    """A paragraph on what the figures of some records were measured with, and whether today's goldens differ.

    Args:
        names: of records; those that are missing are left out.
        today: kind of golden output to its digest; by default, those of this checkout.
    """
    today = goldens() if today is None else today
    found = [record for name in names if (record := load(name, records.folder)) is not None]
    if not found:
        return "Nobody has measured these figures with this version."
    of = ", ".join(sorted({record.measured.release for record in found}))
    days = sorted({record.measured.on for record in found})
    when = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    which = f"record{'s' * (len(found) > 1)} {', '.join(f'`{record.name}`' for record in found)}"
    words = f"The figures are of release {of}, measured {when} ({which})."
    if any(today.get(kind) != digest for record in found for kind, digest in record.measured.goldens.items()):
        words += " What the code makes has changed since, so figures of today may be others."
    return wrapped(words)
