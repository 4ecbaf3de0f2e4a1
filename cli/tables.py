"""What was found in a texture set, for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mipbake.source.jobs import Job
from mipbake.source.sources import DECISIONS, Found, MapSource
from mipbake.source.texture_set import TextureSet

if TYPE_CHECKING:
    from rich.table import Table


def table(*columns: str) -> Table:
    """An empty table in the style that all tables share."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE, pad_edge=False, show_edge=False)
    for column in columns:
        made.add_column(column, overflow="fold")
    return made


def ranked_table(title: str, columns: Sequence[str], rows: Mapping[str, Sequence[tuple[str, float]]]) -> Table:
    """A row of figures for each name; the best of each column is bold.

    Args:
        title: of the names. columns: titles of the figures. rows: name to text and loss in each column.
    """
    from rich.text import Text

    made = table(title, *columns)
    for shown in made.columns[1:]:
        shown.justify = "right"
    least = [min(loss for _, loss in column) for column in zip(*rows.values(), strict=True)]
    for name, row in rows.items():
        cells = (Text(text, "bold" if loss == best else "") for (text, loss), best in zip(row, least, strict=True))
        made.add_row(name, *cells)
    return made


def map_table(sources: Mapping[str, MapSource]) -> Table:
    """One row for each map: where it comes from, how it is read, and why."""
    made = table("map", "from", "size", "stored as", "read as", "why")
    for role, source in sources.items():
        size = f"{source.width} x {source.height}" if source.path else ""
        stored = f"{source.depth} {source.channels}" if source.path else ""
        read = source.encoding + (", inverted" if source.inverted else "")
        made.add_row(role, _origin(source), size, stored, read if source.path else "", source.reason)
    return made


def description(job: Job, found: TextureSet) -> list[str | Table]:
    """What a texture set is and what was found in it, to be printed."""
    return [
        f"{job.source}: {found.name}, {found.width} x {found.height}",
        map_table(found.found.maps),
        *remarks(found.found),
    ]


def remarks_of(job: Job) -> list[str]:
    """The same about what it comes from, one line each."""
    return [*(f"note: {note}" for note in job.notes), *(f"warning: {warning}" for warning in job.warnings)]


def remarks(found: Found) -> list[str]:
    """What was assumed, what to look at, and what was left out, one line each."""
    convention = found.normal_convention
    decision = DECISIONS[convention.decided_by]
    lines = [f"normal convention: {convention.name}, {decision} (confidence {convention.confidence:.2f})"]
    lines += [f"note: {note}" for note in found.notes]
    lines += [f"warning: {warning}" for warning in found.warnings]
    lines += [f"ignored: {_name(item.path)}, {item.reason}" for item in found.ignored]
    return lines


def _name(path: Path | None) -> str:
    return path.name if path else ""


def _origin(source: MapSource) -> str:
    if source.path:
        return source.path.name
    return "constant " + ", ".join(f"{v:g}" for v in source.constant or ())
