"""What `fit_slow.py` has measured, as a table and sentences: a page shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from fit_tables import MEASURES, START
from timing import table

from mipbake.fitting import SCALES
from mipbake.quality.metrics import snr_from_sums


def gains_table(data: Mapping[str, Any]) -> str:
    """Markdown: SNR of what a display shows / of linear radiance, by minutes, set and scale."""
    rows = []
    for name, each in data["sets"].items():
        for stack in each["stacks"]:
            cells = [_snr(each["scales"][scale], stack) for scale in SCALES if scale in each["scales"]]
            rows.append([name, stack if stack == START else f"{stack} min", *cells])
    return table(["set", "after", *SCALES], rows)


def words(data: Mapping[str, Any]) -> str:
    """What the fits took."""
    frame, minutes = data["pace"]["frame"], data["pace"]["minutes"]
    return " ".join(
        f"{name}: {each['frames']:,} frames of {1000 * frame:.0f} ms at least and {each['steps']:,} steps in "
        f"{each['seconds'] / 60:.1f} of {minutes:g} minutes; the first stack was there after {each['first']:.0f} s."
        for name, each in data["sets"].items()
    )


def _snr(views: Sequence[Mapping[str, Any]], stack: str) -> str:
    sums = (np.sum([view["sums"][measure][stack] for view in views], 0) for measure in MEASURES)
    found = map(snr_from_sums, sums)
    return " / ".join(f"{float(each):.1f}" for each in found)
