"""Tables of means over sets, in Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mipbake.quality.figures import SCALES
from mipbake.quality.metrics import MEASURES, PAIR_SETS, mean_interval
from results_page.files import OPTIMUM, SUBJECT, Results

PLACES = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere", "sphere": "sphere"}
DIGITS = {
    "snr": 1,
    "tonemapped": 4,
    "flip": 3,
    "sparkle": 5,
    "hdr-flip": 3,
    "delta-e-itp": 2,
    "ssim": 3,
    "flicker": 2,
    "flicker-snr": 1,
    "jod-37": 2,
    "jod-75": 2,
}


def table(first: str, heads: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    lines = [f"| {first} | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    return "\n".join([*lines, *(f"| {name} | " + " | ".join(cells) + " |" for name, cells in rows.items())]) + "\n"


def average(measure: str, values: np.ndarray) -> tuple[float, float, float]:
    """Mean and its 95 % interval over sets; of flicker, a ratio, the geometric mean. Sets without a figure are
    left out."""
    known = values[np.isfinite(values) & ((values > 0) | (measure != "flicker"))]
    if len(known) < 2:
        return math.nan, math.nan, math.nan
    if measure == "flicker":
        found = mean_interval(np.log(known))
        return math.exp(found.estimate), math.exp(found.low), math.exp(found.high)
    found = mean_interval(known)
    return found.estimate, found.low, found.high


def loss(measure: str, value: float) -> float:
    return MEASURES[measure].loss(value)


def lod_heads(results: Results) -> list[str]:
    return [f"{lod:g}" for lod in results.lods]


def by_lod(results: Results, pairs: str, names: Sequence[str] | None = None) -> str:
    """Mean SNR by level of detail; the best of each column is bold."""
    names = [*results.methods] if names is None else names
    means = {name: [results.curve[name, pairs, lod].mean() for lod in results.lods] for name in names}
    means = {name: [*row, float(np.mean(row))] for name, row in means.items()}
    heads = [*lod_heads(results), "mean"]
    best = [max(row[i] for name, row in means.items() if name != OPTIMUM) for i in range(len(heads))]
    rows = {
        name: [f"**{v:.1f}**" if v == b and name != OPTIMUM else f"{v:.1f}" for v, b in zip(row, best, strict=True)]
        for name, row in means.items()
    }
    return table(pairs, heads, rows)


def by_scale(results: Results, measure: str, view: str) -> str:
    """Means over sets with intervals, by scale; the best of each column is bold. Empty where nothing was measured."""
    known = [name for name in results.methods if any((name, measure, view, s) in results.figures for s in SCALES)]
    scales = [s for s in SCALES if known and all((name, measure, view, s) in results.figures for name in known)]
    found = {
        name: [average(measure, results.figures[name, measure, view, scale]) for scale in scales] for name in known
    }
    if not scales or all(math.isnan(row[0][0]) for row in found.values()):
        return ""
    shown, digits = {}, DIGITS[measure]
    best = [min(loss(measure, row[i][0]) for name, row in found.items() if name != OPTIMUM) for i in range(len(scales))]
    for name, row in found.items():
        shown[name] = []
        for (value, low, high), least in zip(row, best, strict=True):
            mark = "**" if loss(measure, value) == least and name != OPTIMUM else ""
            shown[name].append(
                f"{mark}{value:.{digits}f}{mark} ({low:.{digits}f} to {high:.{digits}f})"
                if not math.isnan(value)
                else ""
            )
    return table("", scales, shown)


def heading(measure: str, view: str) -> str:
    about = MEASURES[measure]
    better = {"higher": "higher is better", "lower": "lower is better", "one": "1 is right"}[about.direction]
    unit = f"{about.unit}, " if about.unit else ""
    return f"#### {about.title}, {PLACES.get(view, view)} ({unit}{better})\n"


def per_set(results: Results, value: Callable[[str, float], np.ndarray], pairs: str) -> str:
    """A row for each set of what `value` gives for all of them at a pair set and lod."""
    columns = [value(pairs, lod) for lod in results.lods]
    rows = {name: [f"{column[i]:+.1f}" for column in columns] for i, name in enumerate(results.sets)}
    return table(pairs, lod_heads(results), rows)


def costs(results: Results) -> str:
    """What a method takes and what it gives."""
    rows = {}
    for name in results.methods:
        means = [np.mean([results.curve[name, pairs, lod] for lod in results.lods]) for pairs in PAIR_SETS]
        cpu, wall, peak = (results.costs[name, what] for what in ("processor_seconds", "seconds", "peak_mib"))
        rows[name] = [
            f"{np.median(cpu):.1f}",
            f"{cpu.max():.1f}",
            f"{np.median(wall):.1f}",
            f"{peak.max():.0f}",
            *(f"{mean:.1f}" for mean in means),
        ]
    heads = ["processor seconds, median", "most", "wall seconds, median", "peak MiB, most"]
    return table("", [*heads, *(f"SNR {pairs}" for pairs in PAIR_SETS)], rows)


def described(results: Results) -> str:
    """A sentence on the weights behind the networks."""
    used = {name: each["weights"] for name, each in results.methods.items() if each.get("weights")}
    if SUBJECT not in used:
        return ""
    return f"`{SUBJECT}` is the network `{used[SUBJECT]}`. "
