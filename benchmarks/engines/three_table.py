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
    return f"""# Results in three.js

three.js r{engine["three"]} in headless Chromium on {notes["machine"]}; renderer: {engine["renderer"]}. Pictures of
{side} x {side} pixels, the middle {texels} x {texels} texels of each set. `python benchmarks/engines/three_proof.py`
makes this page; [README.md](README.md) says how it measures.

## Levels

{_lines(f"- {line}" for line in notes["levels"])}

## Baked against linear, 8 bits a channel (KTX 2, RGBA8)

SNR in dB (higher is better) and FLIP (lower is better); **bold** is the best of a row. `linear` is the box average that
an engine makes of level 0; `linear, filtered` averages under the pixel filter at every level, level 0 included.
`reference` is the SNR of the reference itself, from its two independent halves: it shall lie {MARGIN_DB:g} dB above the
best candidate; * where {2 * most} samples a pixel did not suffice.

{_lines(_main(cells))}

## In every container

Means over the views of a set.

{_lines(_containers(cells))}
"""


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(lines)


def _main(cells: Sequence[Cell]) -> list[str]:
    plain = [cell for cell in cells if cell.container == PLAIN]
    names = list(dict.fromkeys(cell.candidate for cell in plain))
    lines = [
        f"| set | view | lod | {' | '.join(f'SNR {n}' for n in names)} "
        f"| {' | '.join(f'FLIP {n}' for n in names)} | reference |",
        "|---|---|" + "---:|" * (2 * len(names) + 2),
    ]
    rows = []
    for key in dict.fromkeys((cell.set, cell.view) for cell in plain):
        row = {cell.candidate: cell for cell in plain if (cell.set, cell.view) == key}
        rows.append(row)
        linear = row["linear"]
        # What was measured later was measured against a reference of its own.
        noisiest = min(row.values(), key=lambda cell: cell.reference_snr)
        short = " *" if any(cell.reference_snr < cell.snr + MARGIN_DB for cell in row.values()) else ""
        # Rounded as they are shown, so that what reads the same is marked the same.
        snrs, flips = {n: round(row[n].snr, 1) for n in row}, {n: round(row[n].flip, 4) for n in row}
        high, low = max(snrs.values()), min(flips.values())
        shown = [_bold(f"{snrs[n]:.1f}", snrs[n] == high) if n in row else "" for n in names]
        shown += [_bold(f"{flips[n]:.4f}", flips[n] == low) if n in row else "" for n in names]
        lines.append(
            f"| {key[0]} | {key[1]} | {linear.lod:g} | {' | '.join(shown)} | {noisiest.reference_snr:.1f}{short} |"
        )
    return [*lines, "", *_gains(rows, names)]


def _gains(rows: Sequence[Mapping[str, Cell]], names: Sequence[str]) -> list[str]:
    """A table of how every candidate stands beside `linear`: everywhere, by shape and by scale."""
    lines = [
        "| beside `linear` | views | better in SNR | mean gain | least | largest | better in FLIP | its mean change |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    cells = [row["linear"] for row in rows]
    parts = ["all", *dict.fromkeys(c.shape for c in cells), *dict.fromkeys(c.scale for c in cells)]
    for name, part in ((name, part) for name in names if name != "linear" for part in parts):
        pairs = [
            (row[name], row["linear"])
            for row in rows
            if name in row and part in ("all", row["linear"].shape, row["linear"].scale)
        ]
        gains = [a.snr - b.snr for a, b in pairs]
        changes = [round(a.flip, 4) - round(b.flip, 4) for a, b in pairs]  # as the table above shows them
        lines.append(
            f"| {name} | {part} | {sum(g > 0 for g in gains)} of {len(gains)} | {fmean(gains):+.2f} dB "
            f"| {min(gains):+.1f} dB | {max(gains):+.1f} dB "
            f"| {sum(c < 0 for c in changes)} of {len(changes)} | {fmean(changes):+.4f} |"
        )
    return lines


def _containers(cells: Sequence[Cell]) -> list[str]:
    columns = list(dict.fromkeys((cell.candidate, cell.container) for cell in cells))
    lines = [
        f"| set | {' | '.join(f'{name}: {container}' for name, container in columns)} |",
        "|---|" + "---:|" * len(columns),
    ]
    for name in dict.fromkeys(cell.set for cell in cells):
        figures = []
        for column in columns:
            some = [cell for cell in cells if (cell.set, cell.candidate, cell.container) == (name, *column)]
            shown = f"{fmean(c.snr for c in some):.1f} dB, {fmean(c.flip for c in some):.4f}" if some else ""
            figures.append(shown)
        lines.append(f"| {name} | {' | '.join(figures)} |")
    return lines


def _bold(text: str, bold: bool) -> str:
    return f"**{text}**" if bold else text


def processor() -> str:
    """What the figures were measured on."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    named = next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
    cores = sum(line.startswith("processor") for line in lines)
    return f"{named or platform.machine()}, {cores} cores, {platform.system()}"
