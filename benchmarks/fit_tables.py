"""What `fit.py` has measured, as tables and sentences: pages show them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from timing import table

from mipbake.fitting import SCALES
from mipbake.quality.metrics import snr_from_sums

METHODS = ("linear", "lean", "auto")
"""Methods of the bakes that a fit is compared with."""

START, OTHERS = "auto", ("linear",)
"""The method that a fit starts from, and others that levels may start from."""

STAGES = ("start", "steps", "fitted")
"""What a fit does, in order: each level's start is chosen, steps follow, and a round of least squares ends the fit."""

FITTED = STAGES[-1]

MEASURES = ("snr", "snr-displayed")
"""SNR of linear radiance, and SNR of what a display shows of it."""


def snr(data: Mapping[str, Any], renderer: str, name: str, measure: str) -> dict[str, dict[str, float]]:
    """Scale to method to SNR in dB of one set in a renderer: sums run over all views of the scale."""
    scales = data["renderers"][renderer][name]["scales"]
    return {
        scale: {
            method: float(snr_from_sums(np.sum([view["sums"][measure][method] for view in scales[scale]], 0)))
            for method in (*METHODS, *STAGES)
        }
        for scale in SCALES
        if scale in scales
    }


def cells(data: Mapping[str, Any], renderer: str, measure: str) -> Iterator[tuple[str, str, Mapping[str, float]]]:
    """Set, scale, and SNR of each method there."""
    for name in data["renderers"][renderer]:
        for scale, found in snr(data, renderer, name, measure).items():
            yield name, scale, found


def gain(found: Mapping[str, float]) -> float:
    """dB by which the fit is above the best of the others, as tables show it: in tenths."""
    return round(found[FITTED] - max(found[method] for method in METHODS), 1) + 0.0  # and never -0


def means_table(data: Mapping[str, Any], measure: str) -> str:
    """Markdown: the mean SNR over sets, by renderer, method and scale. Bold is the best of a column."""
    rows = []
    for renderer in data["renderers"]:
        found = list(cells(data, renderer, measure))
        means = {
            method: {
                scale: float(np.mean([each[method] for _, where, each in found if where == scale]))
                for scale in SCALES
                if any(where == scale for _, where, _ in found)
            }
            for method in (*METHODS, *STAGES)
        }
        for method, by_scale in means.items():
            shown = [
                "" if scale not in by_scale
                else f"**{by_scale[scale]:.1f}**"
                if f"{by_scale[scale]:.1f}" == f"{max(each[scale] for each in means.values()):.1f}"
                else f"{by_scale[scale]:.1f}"
                for scale in SCALES
            ]  # fmt: skip
            rows.append([renderer, method, *shown])
    return table(["renderer", "SNR in dB, mean over sets", *SCALES], rows)


def words(data: Mapping[str, Any], measure: str) -> str:
    """At how many scales of sets the fit is ahead of the best of the others, equal to it and behind it, and how far."""
    said, every = [], []
    for renderer in data["renderers"]:
        found = [(gain(each), name, scale) for name, scale, each in cells(data, renderer, measure)]
        if not found:
            continue
        every += found
        ahead, equal, behind = ([each for each in found if np.sign(each[0]) == sign] for sign in (1, 0, -1))
        sets = len(data["renderers"][renderer])
        line = (
            f"In `{renderer}`, the fitted stack is ahead of the best of the other three at {len(ahead)} of "
            f"{len(found)} scales of {sets} {'set' if sets == 1 else 'sets'}, equal to it at {len(equal)}, and behind "
            f"it at {len(behind)}"
        )
        if behind:
            least, name, scale = min(behind)
            line += f", at most by {-least:.1f} dB ({name}, {scale})"
        said.append(f"{line}. In the mean, the difference to the best of them is {_mean(found)} dB.")
    if len(said) > 1:
        by_scale = [(scale, [each for each in every if each[2] == scale]) for scale in SCALES]
        parts = [
            f"{sum(each[0] > 0 for each in found)} of {len(found)} ({scale}, {_mean(found)} dB in the mean)"
            for scale, found in by_scale
            if found
        ]
        said.append(f"Over all renderers, the fitted stack is ahead at {', '.join(parts)}.")
    return " ".join(said)


def stages_table(data: Mapping[str, Any], measure: str) -> str:
    """Markdown: dB that each stage of a fit adds to the one before it, in the mean over sets, by renderer and scale."""
    rows = []
    for renderer in data["renderers"]:
        found = list(cells(data, renderer, measure))
        for before, stage in itertools.pairwise((START, *STAGES)):
            added = {
                scale: [each[stage] - each[before] for _, where, each in found if where == scale] for scale in SCALES
            }
            rows.append([renderer, stage, *(f"{_rounded(each):+.1f}" if each else "" for each in added.values())])
    return table(["renderer", "dB that it adds, mean over sets", *SCALES], rows)


def _mean(found: Sequence[tuple[float, str, str]]) -> str:
    return f"{_rounded([each[0] for each in found]):+.1f}"


def _rounded(found: Sequence[float]) -> float:
    """The mean in tenths, and never -0."""
    return round(float(np.mean(found)), 1) + 0.0


def single_table(data: Mapping[str, Any], measure: str) -> str:
    """Markdown: dB by which the fit is above the best of the others, by renderer and set, at each scale."""
    rows = []
    for renderer, sets in data["renderers"].items():
        for name in sets:
            found = snr(data, renderer, name, measure)
            rows.append([
                renderer, name, *(f"{gain(found[scale]):+.1f}" if scale in found else "" for scale in SCALES)
            ])  # fmt: skip
    return table(["renderer", "dB above the best of the others", *SCALES], rows)


def cost_table(data: Mapping[str, Any]) -> str:
    """Markdown: what the fits cost."""
    rows = []
    for renderer, sets in data["renderers"].items():
        for name, each in sets.items():
            seconds, (height, width) = each["seconds"], each["size"]
            rows.append([
                renderer, name, f"{width} x {height}", str(each["views"]), f"{each['steps']:,}",
                *(f"{seconds[part]:.0f} s" for part in ("preparing", "steps", "rounds")),
            ])  # fmt: skip
    return table(
        ["renderer", "set", "texels", "views", "steps", "preparing the views", "the steps", "the rounds"], rows
    )
