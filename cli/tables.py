"""What was found in a texture set, for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mipbake.cli.session import Session
from mipbake.source.jobs import Job
from mipbake.source.options import CARRIED
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


def describe(session: Session, job: Job, found: TextureSet) -> None:
    """Prints what a texture set is and what is doubtful about it; with --verbose, where every map comes from."""
    about, convention = found.found, found.found.normal_convention
    if not session.verbose:
        session.print(f"{found.name}: {found.width} x {found.height}; {_maps(about)}")
    else:
        decision = DECISIONS[convention.decided_by]
        session.print(
            f"{job.source}: {found.name}, {found.width} x {found.height}",
            map_table(about.maps),
            f"normal convention: {convention.name}, {decision} (confidence {convention.confidence:.2f})",
            *(f"note: {note}" for note in about.notes),
            *(f"ignored: {_name(item.path)}, {item.reason}" for item in about.ignored),
        )
    session.print(*(f"warning: {warning}" for warning in about.warnings))


def remark(session: Session, job: Job) -> None:
    """Prints the same about what sets come from."""
    session.details(*(f"note: {note}" for note in job.notes))
    session.print(*(f"warning: {warning}" for warning in job.warnings))


def _maps(found: Found) -> str:
    """The maps of a set, and what stands for maps that it lacks."""
    roles = {role: source for role, source in found.maps.items() if not role.startswith(CARRIED)}
    told = [", ".join(role for role, source in roles.items() if source.path)]
    told += [f"{role} {_values(source)}" for role, source in roles.items() if not source.path]
    return "; ".join(told)


def _name(path: Path | None) -> str:
    return path.name if path else ""


def _origin(source: MapSource) -> str:
    return source.path.name if source.path else f"constant {_values(source)}"


def _values(source: MapSource) -> str:
    return ", ".join(f"{v:g}" for v in source.constant or ())
