"""Tables of means over sets, in Markdown."""

from __future__ import annotations

import math

import numpy as np
from records.wrapping import table

from mipbake.quality.figures import SCALES
from mipbake.quality.metrics import MEASURES, PAIR_SETS
from mipbake.quality.metrics.intervals import mean_interval
from results_page.files import FOUR, LINEAR, OPTIMUM, Results

PLACES = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere", "sphere": "sphere"}
DIGITS = {"snr": 1, "flip": 3, "flicker": 2}
"""Measures of tables, to the digits that they are shown with."""


def average(measure: str, values: np.ndarray) -> float:
    """Mean over sets; of flicker, a ratio, the geometric mean. Sets without a figure are left out, and it is nan where
    fewer than two are left."""
    known = values[np.isfinite(values) & ((values > 0) | (measure != "flicker"))]
    if len(known) < 2:
        return math.nan
    return float(np.exp(np.log(known).mean()) if measure == "flicker" else known.mean())


def by_lod(results: Results, pairs: str) -> str:
    """Mean SNR by level of detail; the best of each column is bold."""
    rows = {name: [results.curve[name, pairs, lod].mean() for lod in results.lods] for name in _shown(results)}
    rows = {name: [*row, np.mean(row)] for name, row in rows.items()}
    best = [max(column) for column in zip(*rows.values(), strict=True)]
    cells = [
        [name, *(f"**{v:.1f}**" if v == b else f"{v:.1f}" for v, b in zip(row, best, strict=True))]
        for name, row in rows.items()
    ]
    return table([pairs, *map("{:g}".format, results.lods), "mean"], cells) + "\n"


def _shown(results: Results) -> list[str]:
    """Methods of tables: of closed forms with the box, only what engines do."""
    return [name for name in results.methods if name == LINEAR or not name.endswith("(box)")]


def methods(results: Results) -> str:
    """Flicker, FLIP and the costs of every method."""
    near, *_, far = SCALES
    rows = []
    for name in _shown(results):
        figures = [(m, view, scale) for m, view in _SHOWN for scale in (near, far)]
        means = [(m, average(m, results.figures[name, m, view, scale])) for m, view, scale in figures]
        seconds = np.median(results.seconds[name])
        rows.append([name, *(f"{value:.{DIGITS[m]}f}" for m, value in means), f"{seconds:.1f}"])
    heads = [f"{MEASURES[m].title}, {scale}" for m, _ in _SHOWN for scale in (near, far)]
    return table(["method", *heads, "processor seconds, median"], rows) + "\n"


_SHOWN = (("flicker", "hemisphere"), ("flip", "sphere"))


def winners(results: Results) -> str:
    """How far each learned method is ahead of the best closed form, by measure, view and scale."""
    rows = []
    for measure in DIGITS:
        for view in (*PAIR_SETS, "sphere"):
            cells = [[_ahead(results, name, measure, view, scale) for name in results.learned] for scale in SCALES]
            if any(any(cell) for cell in cells):
                title = f"{MEASURES[measure].title}, {PLACES[view]}"
                rows.append([title, *(" / ".join(cell) for cell in cells)])
    return table([f"{' / '.join(results.learned)}, better positive", *SCALES], rows) + "\n"


def _ahead(results: Results, name: str, measure: str, view: str, scale: str) -> str:
    """Mean difference to the closed form with the best mean: bold where its 95 % interval is above 0, italic where it
    is below; empty where nothing was measured."""

    def figures(of: str) -> np.ndarray:
        return results.figures.get((of, measure, view, scale), np.array([]))

    def loss(value: float) -> float:
        return MEASURES[measure].loss(value)

    means = {form: average(measure, figures(form)) for form in results.closed_forms}
    rival = min(means, key=lambda form: loss(means[form]))
    better = np.array([loss(b) - loss(a) for a, b in zip(figures(name), figures(rival), strict=True)])
    better = better[np.isfinite(better)]
    if len(better) < 2:
        return ""
    gain = mean_interval(better)
    mark = "**" if gain.low > 0 else "*" if gain.high < 0 else ""
    return f"{mark}{gain.estimate:+.{DIGITS[measure]}f}{mark}"


def won(results: Results, name: str) -> dict[str, np.ndarray]:
    """Scale to whether the FLIP of each set's sphere is below the FLIP of every closed form."""
    scales = [scale for scale in SCALES if (name, "flip", "sphere", scale) in results.figures]
    least = {s: np.min([results.figures[f, "flip", "sphere", s] for f in results.closed_forms], 0) for s in scales}
    return {scale: results.figures[name, "flip", "sphere", scale] < least[scale] for scale in scales}


def gaps(results: Results) -> str:
    """Closed gap by pair set and lod: (method - best of FOUR) / (optimum - best of FOUR) of the means over sets."""
    rows = []
    for pairs in PAIR_SETS:
        top = _means(results, OPTIMUM, pairs)
        rows.append([f"optimum over the best of four, {PLACES[pairs]}", *(f"{gain:+.1f} dB" for gain in top)])
        for name in results.learned:
            cells = [_share(o, t) for o, t in zip(_means(results, name, pairs), top, strict=True)]
            rows.append([f"closed gap of {name}, {PLACES[pairs]}", *cells])
    return table(["", *map("{:g}".format, results.lods), "mean"], rows) + "\n"


def _means(results: Results, name: str, pairs: str) -> list[float]:
    """dB over the best of FOUR by lod, and their mean."""
    gains = results.gains(name, pairs, FOUR).mean(0)
    return [*map(float, gains), float(gains.mean())]


def closed_gap(results: Results, name: str, pairs: str) -> str:
    """Share of the gap over all levels; empty where there is none."""
    return _share(_means(results, name, pairs)[-1], _means(results, OPTIMUM, pairs)[-1])


def _share(own: float, top: float) -> str:
    """Of a gap of at least 0.3 dB, below which a share means nothing."""
    return f"{own / top:.0%}" if top > 0.3 else ""


def targets(results: Results) -> list[tuple[str, str, str]]:
    """Methods that were baked to both targets: name, and what files call it for `gltf` and `gltf-anisotropic`."""
    ends = (" as gltf", " as gltf-anisotropic")
    names = [name.removesuffix(ends[0]) for name in results.methods if name.endswith(ends[0])]
    return [(name, name + ends[0], name + ends[1]) for name in names if name + ends[1] in results.methods]


def two_widths(results: Results) -> str:
    """Mean SNR of both targets, and what the second one gains, at worst and at best."""
    rows = []
    for pairs in PAIR_SETS:
        for name, *both in (each for each in targets(results) if not each[0].endswith(")")):
            snr = [np.mean([results.curve[each, pairs, lod] for lod in results.lods], 0) for each in both]
            gain = snr[1] - snr[0]
            figures = (*(f"{each.mean():.1f}" for each in snr), f"{gain.mean():+.2f}")
            rows.append([f"{name}, {PLACES[pairs]}", *figures, f"{gain.min():+.1f}", f"{gain.max():+.1f}"])
    return table(["mean SNR", "`gltf`", "`gltf-anisotropic`", "gain", "worst", "best"], rows) + "\n"
