"""Pages that print figures: which pages there are, and the blocks in them that are made from records.

A block stands between `<!-- record:RECORD/VIEW -->` and `<!-- end -->`; `records/views.py` makes its text. Where a
record is missing, the block keeps the text that it has. The block `<!-- record:release -->` of a page says which
release the figures of the page are of.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from records.record import ROOT, Records, goldens, load
from records.wrapping import wrapped

RELEASE = "release"

_BLOCK = re.compile(r"(?<!`)(<!-- record:(\S+) -->)(\n?)(.*?)(\n *|)(<!-- end -->)", re.DOTALL)


def pages(root: Path = ROOT) -> list[str]:
    """Markdown files that may have blocks, relative to the root: pages, and cards of weights."""
    folders = ("docs", "examples", "benchmarks", "models/weights")
    found = [root / "README.md", *(path for folder in folders for path in (root / folder).rglob("*.md"))]
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
    changed = {
        kind for record in found for kind, digest in record.measured.goldens.items() if today.get(kind) != digest
    }
    if changed:
        words += (
            f" Since then the golden {' and '.join(sorted(changed))} have changed, so figures of today may be others."
        )
    elif any(record.measured.goldens for record in found):
        words += " The golden outputs of today are the same."
    return wrapped(words)
