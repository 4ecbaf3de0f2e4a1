"""Blocks of docs/pipeline.md: how fast libraries are baked, and what became of one that was killed again and again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from records.wrapping import table, wrapped

if TYPE_CHECKING:
    from records.record import Records


def throughput_by_size(records: Records, name: str) -> str:
    sizes = records[name]["sizes"]
    programs = [program for program in next(iter(sizes.values())) if program != "sets"]
    rows = [
        [f"{size} x {size}", *(" / ".join(f"{row[program][jobs]:,.0f}" for jobs in "12") for program in programs)]
        for size, row in sizes.items()
    ]
    return "\n\n".join([table(["maps", *programs], rows), _where(records, name)])


def throughput_by_format(records: Records) -> str:
    formats = records["throughput"]["formats"]
    rates = [" / ".join(f"{each[jobs]:,.0f}" for jobs in "12") for each in formats.values()]
    return table(["format", *formats], [["sets an hour", *rates]])


def library_words(records: Records) -> str:
    found = records["library"]
    whole, again, one, there = (found[name] for name in ("whole", "again", "one changed", "cluster"))
    killed = [each for each in found["killed"] if each["code"] < 0 or each["code"] > 128]
    same = "the same files, byte for byte" if found["same"] and found["same on cluster"] else "other files"
    return wrapped(
        f"A library of {found['count']} generated sources, {found['broken']} of them broken, was baked by "
        f"{found['jobs']} processes with `linear`: {whole['baked']} results in {whole['seconds']:.0f} s. A second call "
        f"with nothing changed took {again['seconds']:.1f} s; a call after one source was touched took "
        f"{one['seconds']:.1f} s and baked {one['baked']}. Then the command was killed {len(killed)} times with all "
        f"its processes and called again: {found['baked twice']} results were baked twice. On a Ray cluster of two "
        f"machines of one core each, {found['cluster deaths']} processes were killed meanwhile; it took "
        f"{there['seconds']:.0f} s. All ways left {same} ({found['files']} files). {_where(records, 'library')}"
    )


def _where(records: Records, name: str) -> str:
    record = records.record(name)
    return f"Measured {record.measured.on} on {record.measured.machine}."


SCALING_VIEWS: Mapping[str, Callable[[Records], str]] = {
    "throughput/by-size": lambda records: throughput_by_size(records, "throughput"),
    "throughput-large/by-size": lambda records: throughput_by_size(records, "throughput-large"),
    "throughput/by-format": throughput_by_format,
    "library/words": library_words,
}
