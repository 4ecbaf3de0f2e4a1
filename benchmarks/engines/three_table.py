"""The tables of what was measured in three.js."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

PLAIN = "ktx2-rgba8"
"""The container of the main table."""

MARGIN_DB = 15.0
"""dB by which the reference's own noise shall lie below the error of the best candidate."""


@dataclass(frozen=True)
class Cell:
    """One candidate in one view.

    Args:
        set, view: names. shape, scale: of the view. lod: its median level of detail.
        candidate, container: what was rendered, and how it reached the engine.
        snr, flip: against the reference; dB, and 0 to 1.
        samples: a pixel in each half of the reference. reference_snr: of both halves' mean, dB.
    """

    set: str
    view: str
    shape: str
    scale: str
    lod: float
    candidate: str
    container: str
    snr: float
    flip: float
    samples: int
    reference_snr: float


def page_of(data: Mapping[str, Any]) -> str:
    """The Markdown page of what three_proof.py writes.

    `sizes` of its notes are pixels a side of pictures, texels a side of textures, and most samples a pixel in each
    half of the reference.
    """
    cells, notes = [Cell(**each) for each in data["cells"]], data["notes"]
    side, texels, most = notes["sizes"]
    engine = notes["engine"]
    plain = [cell for cell in cells if cell.container == PLAIN]
    views = [
        {c.candidate: c for c in plain if (c.set, c.view) == key}
        for key in dict.fromkeys((c.set, c.view) for c in plain)
    ]
    # What was measured later was measured against a reference of its own.
    noisy = sum(any(cell.reference_snr < cell.snr + MARGIN_DB for cell in row.values()) for row in views)
    return f"""# Results in three.js

three.js r{engine["three"]} in headless Chromium on {notes["machine"]}; renderer: {engine["renderer"]}. Pictures of
{side} x {side} pixels, the middle {texels} x {texels} texels of each set. `python benchmarks/engines/three_proof.py`
makes this page; [README.md](README.md) says how it measures.

## Levels

{_lines(f"- {line}" for line in notes["levels"])}

## Baked against linear, 8 bits a channel (KTX 2, RGBA8)

The table compares with `linear`, the box average that an engine makes of level 0. `linear, filtered` averages under the
pixel filter at every level, level 0 included. Of these {len(views)} views {noisy} have a reference that lies less than
{MARGIN_DB:g} dB above the best candidate after {2 * most} samples a pixel. The
[record](../records/engines-three.json) has the figures of each view.

{_lines(_gains(views))}

## In every container

Means over the views.

{_lines(_containers(cells))}
"""


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(lines)


def _gains(rows: Sequence[Mapping[str, Cell]]) -> list[str]:
    """A table of how every candidate stands beside `linear`: everywhere, by shape and by scale."""
    lines = [
        "| beside `linear` | views | better in SNR | mean gain | least | largest | better in FLIP | its mean change |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    cells, names = [row["linear"] for row in rows], dict.fromkeys(name for row in rows for name in row)
    parts = ["all", *dict.fromkeys(c.shape for c in cells), *dict.fromkeys(c.scale for c in cells)]
    for name, part in ((name, part) for name in names if name != "linear" for part in parts):
        pairs = [
            (row[name], row["linear"])
            for row in rows
            if name in row and part in ("all", row["linear"].shape, row["linear"].scale)
        ]
        gains = [a.snr - b.snr for a, b in pairs]
        changes = [round(a.flip, 4) - round(b.flip, 4) for a, b in pairs]
        lines.append(
            f"| {name} | {part} | {sum(g > 0 for g in gains)} of {len(gains)} | {fmean(gains):+.2f} dB "
            f"| {min(gains):+.1f} dB | {max(gains):+.1f} dB "
            f"| {sum(c < 0 for c in changes)} of {len(changes)} | {fmean(changes):+.4f} |"
        )
    return lines


def _containers(cells: Sequence[Cell]) -> list[str]:
    lines = ["| candidate, container | SNR | FLIP |", "|---|---:|---:|"]
    for column in dict.fromkeys((cell.candidate, cell.container) for cell in cells):
        some = [cell for cell in cells if (cell.candidate, cell.container) == column]
        lines.append(
            f"| {', '.join(column)} | {fmean(c.snr for c in some):.1f} dB | {fmean(c.flip for c in some):.4f} |"
        )
    return lines


def processor() -> str:
    """What the figures were measured on."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    named = next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
    cores = sum(line.startswith("processor") for line in lines)
    return f"{named or platform.machine()}, {cores} cores, {platform.system()}"
