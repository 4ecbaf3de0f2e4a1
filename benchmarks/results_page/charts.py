"""The charts of docs/results.md: quality against time, and the paper's figure 5."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from mipbake.quality.metrics import PAIR_SETS
from results_page.files import OPTIMUM, Results
from results_page.svg import Axis, Drawing, spread
from results_page.tables import PLACES

_LEFT, _TOP, _WIDE, _HIGH, _GAP = 56, 64, 400, 330, 76

_SCALES = {"near": (0.0, 1.0), "middle": (2.0, 3.0), "far": (5.0, 7.0)}
"""Levels of detail of texture space that are shown as the paper's scales."""

_COLOURS = {"near": "a", "middle": "b", "far": "c"}
_BINS = 24

Range = tuple[float, float]


def cost_chart(results: Results) -> str:
    """SVG: mean SNR of every method against the processor time that it takes, a panel for each pair set."""
    names = [name for name in results.methods if name != OPTIMUM]
    time = {name: max(float(np.median(results.costs[name, "processor_seconds"])), 1e-3) for name in names}
    width, height = _LEFT + len(PAIR_SETS) * (_WIDE + _GAP), _TOP + _HIGH + 56
    drawing = Drawing(width, height, "SNR against bake time")
    drawing.text(_LEFT, 24, f"Quality against bake time, means over {len(results.sets)} texture sets", "title")
    for panel, pairs in enumerate(PAIR_SETS):
        left = _LEFT + panel * (_WIDE + _GAP)
        snr = {name: float(np.mean([results.curve[name, pairs, lod] for lod in results.lods])) for name in names}
        x = Axis(min(time.values()) / 1.5, max(time.values()) * 12, left, left + _WIDE, True)
        y = Axis(math.floor(min(snr.values()) - 0.5), math.ceil(max(snr.values()) + 0.5), _TOP + _HIGH, _TOP)
        drawing.text(left, 48, f"SNR {PLACES[pairs]}", "ink")
        drawing.grid(x, y)
        drawing.text(left + _WIDE / 2, _TOP + _HIGH + 38, "processor seconds a set, median (log)", "dim middle")
        drawing.text(left - 36, _TOP + _HIGH / 2, "mean SNR (dB), higher is better", "dim middle", turned=True)
        places = spread([y(snr[name]) for name in names], 13, _TOP + 6, _TOP + _HIGH - 4)
        reach = max(x(time[name]) for name in names if name in results.closed_forms) + 18
        for name, place in zip(names, places, strict=True):
            closed = name in results.closed_forms
            at, high = x(time[name]), y(snr[name])
            label = max(reach, at + 14) if closed else at + 12
            drawing.line(at + 4, high, label - 3, place)
            hint = f"{name}: {snr[name]:.1f} dB, {time[name]:.1f} s"
            drawing.dot(at, high, 4 if closed else 6, "rest" if closed else "a", hint)
            drawing.text(label, place + 4, name, "dim" if closed else "ink")
    return drawing.to_svg()


def gain_histograms(results: Results, subject: str, rivals: Sequence[str], title: str) -> str:
    """SVG after figure 5 of Kemppinen et al. 2023: how far a method is ahead of each rival, a count a set and scale."""
    columns: list[tuple[str, Range, Callable[[str, str], np.ndarray]]] = [
        (
            f"SNR {PLACES[pairs]}, dB",
            (-10.0, 10.0),
            lambda rival, scale, pairs=pairs: _snr(results, subject, rival, pairs, scale),
        )  # type: ignore[misc]
        for pairs in PAIR_SETS
    ]
    columns.append(("FLIP of spheres, rival's minus own", (-0.1, 0.1), lambda r, s: _flip(results, subject, r, s)))
    wide, high, left = 230, 84, 130
    drawing = Drawing(left + len(columns) * (wide + 40), 94 + len(rivals) * (high + 44), title)
    drawing.text(16, 24, title, "title")
    for index, (scale, colour) in enumerate(_COLOURS.items()):
        drawing.rectangle(16 + 90 * index, 36, 11, 11, colour)
        drawing.text(32 + 90 * index, 46, scale, "dim")
    drawing.text(290, 46, "right of the line: better than the rival; the outermost bars hold what is beyond", "dim")
    for column, (name, extent, values) in enumerate(columns):
        start = left + column * (wide + 40)
        drawing.text(start + wide / 2, 68, name, "ink middle")
        for row, rival in enumerate(rivals):
            top = 94 + row * (high + 44)
            if column == 0:
                drawing.text(left - 12, top + high / 2, rival, "ink end")
            found = {scale: values(rival, scale) for scale in _COLOURS}
            _histogram(drawing, found, Axis(*extent, start, start + wide), top, high)
    return drawing.to_svg()


def _snr(results: Results, subject: str, rival: str, pairs: str, scale: str) -> np.ndarray:
    low, high = _SCALES[scale]
    lods = [lod for lod in results.lods if low <= lod <= high]
    gains = [results.curve[subject, pairs, lod] - results.curve[rival, pairs, lod] for lod in lods]
    return np.concatenate(gains) if gains else np.empty(0)


def _flip(results: Results, subject: str, rival: str, scale: str) -> np.ndarray:
    key = ("flip", "sphere", scale)
    if (subject, *key) not in results.figures:
        return np.empty(0)
    return np.asarray(results.figures[(rival, *key)] - results.figures[(subject, *key)])


def _histogram(drawing: Drawing, found: dict[str, np.ndarray], x: Axis, top: float, high: float) -> None:
    """Stacked bars, a colour for each scale, over an axis with its zero marked."""
    edges = np.linspace(x.low, x.high, _BINS + 1)
    inside = {scale: np.clip(values[np.isfinite(values)], x.low, x.high) for scale, values in found.items()}
    counts = {scale: np.histogram(values, edges)[0] for scale, values in inside.items()}
    most = max(int(sum(counts.values()).max()), 1)  # type: ignore[union-attr]
    base = np.zeros(_BINS)
    for scale, count in counts.items():
        for index in np.flatnonzero(count):
            tall = count[index] / most * high
            drawing.rectangle(
                x(edges[index]) + 0.5, top + high - base[index] - tall, x(edges[1]) - x(edges[0]) - 1, tall,
                _COLOURS[scale],
            )  # fmt: skip
            base[index] += tall
    drawing.line(x.start, top + high, x.stop, top + high)
    drawing.line(x(0.0), top, x(0.0), top + high + 4, "zero")
    for tick in x.ticks():
        drawing.text(x(tick), top + high + 16, f"{tick:+g}" if tick else "0", "dim middle")
    every = np.concatenate([values[np.isfinite(values)] for values in found.values()])
    if len(every):
        drawing.text(x.stop, top - 6, f"{(every > 0).mean():.0%} ahead", "dim end")
    drawing.text(x.start, top - 6, f"tallest bar: {most}", "dim")
