"""What `fit.py` and `fit_slow.py` have measured, as tables and sentences: pages show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np
from timing import table

from mipbake.fitting import SCALES
from mipbake.quality.metrics import snr_from_sums

METHODS = ("linear", "lean", "auto")
"""Methods of the bakes that a fit is compared with."""

START, OTHERS = "auto", ("linear",)
"""The method that a fit starts from, and others that levels may start from."""

FITTED = "fitted"

MEASURES = ("snr-displayed", "snr")
"""SNR of what a display shows, and of linear radiance."""


def _snr(views: Sequence[Mapping[str, Any]], measure: str, stack: str) -> float:
    """SNR in dB: sums run over all views of a scale."""
    return float(snr_from_sums(np.sum([view["sums"][measure][stack] for view in views], 0)))


def cells(data: Mapping[str, Any], renderer: str, measure: str) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """Set, scale, and SNR in dB of each method there."""
    for name, each in data["renderers"][renderer].items():
        for scale in (scale for scale in SCALES if scale in each["scales"]):
            yield name, scale, {m: _snr(each["scales"][scale], measure, m) for m in (*METHODS, FITTED)}


def gain(found: Mapping[str, float]) -> float:
    """dB by which the fit is above the best of the others, as tables show it: in tenths."""
    return round(found[FITTED] - max(found[method] for method in METHODS), 1) + 0.0  # and never -0


def means_table(data: Mapping[str, Any]) -> str:
    """Markdown: the mean SNR over sets by renderer, method and scale, of what a display shows / of linear radiance."""
    rows = []
    for renderer in data["renderers"]:
        found: dict[tuple[str, str, str], list[float]] = {}
        for measure in MEASURES:
            for _, scale, each in cells(data, renderer, measure):
                for method, snr in each.items():
                    found.setdefault((method, scale, measure), []).append(snr)
        scales = list(dict.fromkeys(scale for _, scale, _ in found))
        for method in (*METHODS, FITTED):
            shown = (" / ".join(f"{np.mean(found[method, scale, each]):.1f}" for each in MEASURES) for scale in scales)
            rows.append([renderer, method, *shown])
    return table(["renderer", "SNR in dB", *SCALES], rows)


def words(data: Mapping[str, Any], measure: str) -> str:
    """At how many scales of sets the fit is ahead of the best of the others, equal to it and behind it, and how far."""
    said = []
    for renderer in data["renderers"]:
        found = [gain(each) for _, _, each in cells(data, renderer, measure)]
        ahead, equal, behind = (sum(np.sign(each) == sign for each in found) for sign in (1, 0, -1))
        said.append(
            f"In `{renderer}`, the fitted stack is ahead of the best of the other three at {ahead} of {len(found)} "
            f"scales of sets, equal to it at {equal}, and behind it at {behind}; the difference is {_mean(found)} dB "
            f"in the mean, and {min(found):+.1f} dB at worst."
        )
    return " ".join(said)


def _mean(found: Sequence[float]) -> str:
    """In tenths, and never -0."""
    return f"{round(float(np.mean(found)), 1) + 0.0:+.1f}"


def cost_table(data: Mapping[str, Any]) -> str:
    """Markdown: medians over sets of what the fits cost."""
    every = [each["seconds"] for sets in data["renderers"].values() for each in sets.values()]
    parts = [part for part in every[0] if part not in ("baking", "measuring")]
    rows = [
        [renderer, *(f"{median(each['seconds'][part] for each in sets.values()):.0f} s" for part in parts)]
        for renderer, sets in data["renderers"].items()
    ]
    return table(["renderer", *parts], rows)


def slow_table(data: Mapping[str, Any]) -> str:
    """Markdown: SNR of what a display shows / of linear radiance, by minutes in a slow renderer, set and scale."""
    rows = []
    for name, each in data["sets"].items():
        scales = [each["scales"][scale] for scale in SCALES if scale in each["scales"]]
        for stack in each["stacks"]:
            shown = (" / ".join(f"{_snr(views, measure, stack):.1f}" for measure in MEASURES) for views in scales)
            rows.append([name, stack if stack == START else f"{stack} min", *shown])
    return table(["set", "after", *SCALES], rows)


def slow_words(data: Mapping[str, Any]) -> str:
    """What the fits in a slow renderer took."""
    frame, minutes = data["pace"]["frame"], data["pace"]["minutes"]
    return " ".join(
        f"{name}: {each['frames']:,} frames of {1000 * frame:.0f} ms at least and {each['steps']:,} steps in "
        f"{each['seconds'] / 60:.1f} of {minutes:g} minutes; the first stack was there after {each['first']:.0f} s."
        for name, each in data["sets"].items()
    )
