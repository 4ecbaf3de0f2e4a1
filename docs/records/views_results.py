"""Blocks of the README made from the records of benchmarks/results.py."""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from mipbake.quality.metrics import PAIR_SETS
from records.record import Missing
from records.scripts import script

if TYPE_CHECKING:
    from records.record import Records

_files, _tables = (script("benchmarks", f"results_page.{name}") for name in ("files", "tables"))
FOUR, LINEAR, SUBJECT = _files.FOUR, _files.LINEAR, _files.SUBJECT

SHOWN = {
    LINEAR: "plain MIP maps (`linear (box)`)",
    "lean (gaussian)": "LEAN mapping (`lean (gaussian)`)",
    "unreal (gaussian)": "Unreal Engine's rule (`unreal (gaussian)`)",
    "godot (gaussian)": "Godot's rule (`godot (gaussian)`)",
    SUBJECT: "mipbake's network (`neural`)",
    "auto": "mipbake (`auto`, the default)",
}
"""Methods of the README's table to what the table calls them."""

_LODS = (0.0, 1.0, 3.0, 5.0)
_NEAR, _OVER = PAIR_SETS


def results_table(records: Records) -> str:
    """Mean SNR of a few methods: near the mirror by level of detail, and the means of both pair sets."""
    results = _of(records, "whole")
    best = "best of `linear` and `lean` for each set and level"
    rows = {
        title: _row(results, lambda pairs, lod, name=name: results.curve[name, pairs, lod])  # type: ignore[misc]
        for name, title in SHOWN.items()
    }
    rows[best] = _row(results, lambda pairs, lod: results.best_of(pairs, lod, FOUR))
    heads = [*(f"highlights, lod {lod:g}" for lod in _LODS), "highlights, mean", "all directions, mean"]
    top = [max(row[i] for title, row in rows.items() if title != best) for i in range(len(heads))]
    lines = [f"| method | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for title, row in rows.items():
        marks = ["**" if value == most and title != best else "" for value, most in zip(row, top, strict=True)]
        cells = [f"{mark}{value:.1f}{mark}" for value, mark in zip(row, marks, strict=True)]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return "\n" + "\n".join(lines) + "\n"


def results_words(records: Records) -> str:
    """What the README's table was measured on."""
    results = _of(records, "whole")
    return (
        "The figures are mean signal-to-noise ratios in dB against the supersampled reference; more is better. The "
        f"means are over {len(results.sets)} real texture sets that the training never saw. `highlights` holds pairs "
        "of light and view around the mirror direction (`near-mirror` elsewhere), and `all directions` holds pairs "
        "from everywhere (`hemisphere`). At lod L a pixel covers 2^L texels; the last two columns are means over "
        f"{len(results.lods)} lods. Rules marked `(gaussian)` average under mipbake's pixel filter; engines average "
        "with the box. Bold is the best method of a column. The last row is an oracle. It knows the figures, and picks "
        "the best of four closed forms for every set and lod. By FLIP, which compares pictures, `auto` is nearer to "
        f"the reference than every closed form in {_seen(results, 'auto')} of cases, and the network alone in "
        f"{_seen(results, SUBJECT)}. In motion, from near and under single lights, the pixels of `auto` change "
        f"{_flicker(results, 'auto')} times as much as they should, and the pixels of plain MIP maps "
        f"{_flicker(results, LINEAR)} times (mean over sets, all directions)."
    )


def _seen(results: Any, name: str) -> str:
    return f"{np.mean([*_tables.won(results, name).values()]):.0%}"


def _flicker(results: Any, name: str) -> str:
    return f"{_tables.average('flicker', results.figures[name, 'flicker', _OVER, 'near']):.1f}"


def _row(results: Any, figures: Callable[[str, float], np.ndarray]) -> list[float]:
    """One row of the table, rounded as it is shown; `figures` gives the figures of all sets for a pair set and lod."""
    near = [figures(_NEAR, lod).mean() for lod in _LODS]
    means = [fmean(figures(pairs, lod).mean() for lod in results.lods) for pairs in PAIR_SETS]
    return [round(float(value), 1) for value in (*near, *means)]


def _of(records: Records, kind: str) -> Any:
    found = _files.read(records.folder, kind)
    if found is None:
        raise Missing(f"results-{kind}")
    return found
