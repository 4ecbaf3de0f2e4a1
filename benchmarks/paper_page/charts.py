"""Figure 5 of Kemppinen et al. 2023 as SVG that follows the reader's dark or light mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape

import numpy as np
from results_page.files import Results
from results_page.tables import PLACES

from mipbake.quality.metrics import PAIR_SETS

_SCALES = {"near": (0.0, 1.0), "middle": (2.0, 3.0), "far": (5.0, 7.0)}
"""Levels of detail of texture space that are shown as the paper's scales."""

_COLOURS = {"near": "a", "middle": "b", "far": "c"}
_BINS = 24
_WIDE, _HIGH, _LEFT = 230, 84, 130

_STYLE = """\
svg { font: 12px system-ui, sans-serif; --ground: #ffffff; --ink: #1f2328; --dim: #59636e; --line: #d1d9e0;
      --a: #0969da; --b: #bf3989; --c: #9a6700; }
@media (prefers-color-scheme: dark) {
  svg { --ground: #0d1117; --ink: #e6edf3; --dim: #9198a1; --line: #3d444d;
        --a: #58a6ff; --b: #f778ba; --c: #e3b341; }
}
.ground { fill: var(--ground); } .title { fill: var(--ink); font-size: 14px; font-weight: 600; }
.ink { fill: var(--ink); } .dim { fill: var(--dim); } .line { stroke: var(--line); stroke-width: 1; fill: none; }
.zero { stroke: var(--dim); stroke-width: 1; } .a { fill: var(--a); } .b { fill: var(--b); } .c { fill: var(--c); }
.end { text-anchor: end; } .middle { text-anchor: middle; }
"""


def gain_histograms(results: Results, subject: str, rivals: Sequence[str], title: str) -> str:
    """How far a method is ahead of each rival: a count a set and scale."""
    columns: list[tuple[str, float, Callable[[str, str], np.ndarray]]] = [
        (f"SNR {PLACES[pairs]}, dB", 10.0, lambda r, s, pairs=pairs: _snr(results, subject, r, pairs, s))  # type: ignore[misc]
        for pairs in PAIR_SETS
    ]
    columns.append(("FLIP of spheres, rival's minus own", 0.1, lambda r, s: _flip(results, subject, r, s)))
    parts = [_text(16, 24, title, "title")]
    for index, (scale, colour) in enumerate(_COLOURS.items()):
        parts += [_bar(16 + 90 * index, 36, 11, 11, colour), _text(32 + 90 * index, 46, scale, "dim")]
    parts.append(_text(290, 46, "right of the line: better than the rival; the outermost bars hold what is beyond"))
    parts += [_text(_LEFT - 12, _top(row) + _HIGH / 2, rival, "ink end") for row, rival in enumerate(rivals)]
    for column, (name, most, values) in enumerate(columns):
        start = _LEFT + column * (_WIDE + 40)
        parts.append(_text(start + _WIDE / 2, 68, name, "ink middle"))
        for row, rival in enumerate(rivals):
            parts += _histogram({scale: values(rival, scale) for scale in _COLOURS}, most, start, _top(row))
    width, height = _LEFT + len(columns) * (_WIDE + 40), _top(len(rivals))
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
            f'width="{width:g}" height="{height:g}" role="img">',
            f"<title>{escape(title)}</title>",
            f"<style>{_STYLE}</style>",
            f'<rect width="{width:g}" height="{height:g}" rx="6" class="ground"/>',
            *parts,
            "</svg>\n",
        ]
    )


def _top(row: int) -> int:
    return 94 + row * (_HIGH + 44)


def _text(x: float, y: float, words: str, kind: str = "dim") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}">{escape(words)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, kind: str = "line") -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{kind}"/>'


def _bar(x: float, y: float, width: float, height: float, kind: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" class="{kind}"/>'


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


def _histogram(found: dict[str, np.ndarray], most: float, left: float, top: float) -> list[str]:
    """Stacked bars from -most to most, a colour for each scale, over an axis with its zero marked."""
    known = {scale: values[np.isfinite(values)] for scale, values in found.items()}
    edges = np.linspace(-most, most, _BINS + 1)
    counts = {scale: np.histogram(np.clip(values, -most, most), edges)[0] for scale, values in known.items()}
    tallest = max(int(np.sum([*counts.values()], 0).max()), 1)
    base, step = np.zeros(_BINS), _WIDE / _BINS
    parts = []
    for scale, count in counts.items():
        for index in np.flatnonzero(count):
            tall = count[index] / tallest * _HIGH
            at = left + index * step
            parts.append(_bar(at + 0.5, top + _HIGH - base[index] - tall, step - 1, tall, _COLOURS[scale]))
            base[index] += tall
    middle, bottom = left + _WIDE / 2, top + _HIGH
    parts += [_line(left, bottom, left + _WIDE, bottom), _line(middle, top, middle, bottom + 4, "zero")]
    for index, tick in enumerate((-most, -most / 2, 0, most / 2, most)):
        parts.append(_text(left + index * _WIDE / 4, bottom + 16, f"{tick:+g}" if tick else "0", "dim middle"))
    every = np.concatenate([*known.values()])
    if len(every):
        parts.append(_text(left + _WIDE, top - 6, f"{(every > 0).mean():.0%} ahead", "dim end"))
    return [*parts, _text(left, top - 6, f"tallest bar: {tallest}")]
