"""The tables of what was measured in three.js."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent.parent))
from timing import arguments, expect, keep, table

__all__ = ["BAKED", "PLAIN_MAPS", "Cell", "arguments", "containers", "expect", "gains", "gallery", "keep"]

PLAIN = "ktx2-rgba8"
"""The container of the main table."""

LINEAR = "linear"

PLAIN_MAPS, BAKED = "plain MIP maps", "mipbake"
"""What films of the gallery show beside the truth."""

SHOWN: Mapping[str, str] = {
    "wet_asphalt": "Stones under a film of water, and puddles",
    "embossed_steel": "Sheet metal with round bumps",
    "brushed_aluminium": "Marks of a brush, in the normals",
    "black_tiles": "Small tiles with a wavy black glaze",
    "pebbled_leather": "Polished leather with a pebbled grain",
    "sparkling_snow": "Matte snow, and a few crystals that mirror",
    "ocean": "Waves of a fresh breeze",
    "knurled_plate": "Steel with pyramids of four sides, whose four directions no texel can hold",
}
"""Set of the gallery to what it is."""

_APART = 0.1
"""JOD from which one sees a difference."""

_FAR = 5.0
"""JOD below which a film looks like another material."""

Cell = Mapping[str, Any]
"""One candidate in one view: `set`, `view`, its `shape` and `scale`, `candidate`, `container`, `snr` in dB, `flip`."""


def gains(data: Mapping[str, Any]) -> str:
    """How every candidate stands beside `linear`, the box average that an engine makes of level 0: everywhere, by shape
    and by scale."""
    views: dict[tuple[str, str], dict[str, Cell]] = {}
    for cell in data["cells"]:
        if cell["container"] == PLAIN:
            views.setdefault((cell["set"], cell["view"]), {})[cell["candidate"]] = cell
    cells = [view[LINEAR] for view in views.values()]
    parts = ["all", *dict.fromkeys(c["shape"] for c in cells), *dict.fromkeys(c["scale"] for c in cells)]
    rows = []
    for name in dict.fromkeys(name for view in views.values() for name in view if name != LINEAR):
        for part in parts if name == "auto" else parts[:1]:
            pairs = [
                (view[name], view[LINEAR])
                for view in views.values()
                if name in view and part in ("all", view[LINEAR]["shape"], view[LINEAR]["scale"])
            ]
            gained = [a["snr"] - b["snr"] for a, b in pairs]
            changes = [round(a["flip"], 4) - round(b["flip"], 4) for a, b in pairs]
            better, lower = sum(each > 0 for each in gained), sum(each < 0 for each in changes)
            most = (f"{each:+.1f} dB" for each in (min(gained), max(gained)))
            rows.append(
                [f"{name}: {part}", f"{better} of {len(pairs)}", f"{fmean(gained):+.2f} dB", *most,
                 f"{lower} of {len(pairs)}", f"{fmean(changes):+.4f}"]
            )  # fmt: skip
    heads = ["beside `linear`", "better in SNR", "mean gain", "least", "largest", "better in FLIP", "its mean change"]
    return table(heads, rows)


def containers(data: Mapping[str, Any]) -> str:
    """Means over the views of candidates that were seen in several containers."""
    found: dict[tuple[str, str], list[Cell]] = {}
    for cell in data["cells"]:
        found.setdefault((cell["candidate"], cell["container"]), []).append(cell)
    several = {name for name, container in found if container != PLAIN}
    rows = [
        [f"{name}, {container}", f"{fmean(c['snr'] for c in some):.1f} dB", f"{fmean(c['flip'] for c in some):.4f}"]
        for (name, container), some in found.items()
        if name in several
    ]
    return table(["candidate, container", "SNR", "FLIP"], rows)


def gallery(data: Mapping[str, Any]) -> str:
    """The films of docs/gallery.md, each with what one sees in it."""
    parts = []
    for name, found in data["sets"].items():
        (plain, baked), title = (found[each] for each in (PLAIN_MAPS, BAKED)), name.replace("_", " ").capitalize()
        gain = round(baked["jod"] - plain["jod"], 6)
        seen = "is truer" if gain >= _APART else "is worse" if gain <= -_APART else "looks the same"
        words = f"{SHOWN[name]}. mipbake {seen}: {baked['jod']:.1f} JOD, plain MIP maps {plain['jod']:.1f}."
        if max(plain["jod"], baked["jod"]) < _FAR:
            words += " Both are far from the truth."
        if plain["flicker"] and baked["flicker"]:
            words += f" From frame to frame mipbake changes {baked['flicker']:.1f} times as much as the truth"
            words += f", plain MIP maps {plain['flicker']:.1f} times."
        parts.append(f"## {title}\n\n{words}\n\n![{title}: plain MIP maps, mipbake, truth](gallery-{name}.webp)")
    return "\n\n".join(parts)
