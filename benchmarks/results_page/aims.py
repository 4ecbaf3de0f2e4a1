"""The section of docs/results.md about `--aim`: the front between decibels and what people see, and its limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from statistics import fmean, geometric_mean

from records.record import load
from records.wrapping import table

from mipbake.quality.judging.weights import SEEN
from mipbake.quality.metrics.pairs import PAIR_SETS
from results_page.svg import Axis, Drawing, spread
from results_page.tables import PLACES

FILE = "results-aims.svg"
LIMIT, PLAIN = "optimum of what is seen", "linear (box)"
_AIM, _BEST = "auto, aim ", "best closed form"

_WORDS = """\
On the middle {side} x {side} texels of each of {sets} sets, `auto` was baked with several aims, for the sampler
`trilinear`. SNR is in dB. What is seen is the [visible error](method.md#the-visible-error) of small pictures that face
the viewer, and of slanted ones; less is better. Figures are means over levels of detail and sets, of visible errors the
geometric means. `optimum` is the limit of the SNR. `{limit}` is the same descent where what is seen counts
alone. Both descents end after 40 rounds; longer ones would find more SNR, or less visible error. The best closed form
is an oracle: the least visible error, and the most SNR, of {forms} closed forms for every set and column.
"""

Figures = Mapping[str, Mapping[str, float]]


def section(folder: Path, page: Path) -> list[str]:
    """Headings, tables and words, and the chart beside the page; nothing where there is no record."""
    record = load("aims", folder)
    if record is None:
        return []
    sets: Mapping[str, Figures] = record.data["sets"]
    means = _means(sets)
    (page.parent / FILE).write_text(_chart(means), encoding="utf-8")
    forms = [name for name in next(iter(sets.values())) if _is_form(name)]
    columns = (*PAIR_SETS, *SEEN)
    rows = [
        [name, *(f"{found[key]:.{1 if key in PAIR_SETS else 3}f}" for key in columns)] for name, found in means.items()
    ]
    return [
        "## Aims: decibels against what people see\n",
        _WORDS.format(side=record.data["side"], sets=len(sets), limit=LIMIT, forms=len(forms)),
        f"![SNR against visible error by aim]({FILE})\n",
        table(["", *(f"SNR {PLACES[pairs]}" for pairs in PAIR_SETS), *SEEN], rows) + "\n",
        _gaps(sets) + "\n",
    ]


def _is_form(name: str) -> bool:
    return name.endswith((" (box)", " (gaussian)"))


def _means(sets: Mapping[str, Figures]) -> dict[str, dict[str, float]]:
    """Method to its means over sets: PLAIN, the best closed form of every set and column, and all other methods."""
    every = [{**found, _BEST: _best(found)} for found in sets.values()]
    names = [PLAIN, _BEST, *(name for name in next(iter(sets.values())) if not _is_form(name))]
    return {
        name: {key: _mean(key)([found[name][key] for found in every]) for key in (*PAIR_SETS, *SEEN)} for name in names
    }


def _best(found: Figures) -> dict[str, float]:
    """The most SNR of all closed forms of a set, and the least visible error."""
    forms = [figures for name, figures in found.items() if _is_form(name)]
    return {key: (max if key in PAIR_SETS else min)(form[key] for form in forms) for key in forms[0]}


def _mean(key: str) -> Callable[[Iterable[float]], float]:
    return fmean if key in PAIR_SETS else geometric_mean


def _gaps(sets: Mapping[str, Figures]) -> str:
    """How much of the way from the best closed form to the limit of what is seen each aim goes, in logarithms."""
    means = _means(sets)
    names = [name for name in means if name.startswith(_AIM)]

    def log(name: str) -> float:
        return fmean(math.log(means[name][kind]) for kind in SEEN)

    way = log(_BEST) - log(LIMIT)
    parts = [f"{(log(_BEST) - log(name)) / way:.0%} with {name.removeprefix('auto, ')}" for name in names]
    return (
        "Of the way from the best closed form of each set to the limit of what is seen, in the logarithm of the "
        f"visible error, `auto` goes {', '.join(parts)}, and the network goes "
        f"{(log(_BEST) - log('neural')) / way:.0%}."
    )


def _chart(means: Mapping[str, Mapping[str, float]]) -> str:
    """SVG: what is seen against SNR, the aims joined by a line."""
    at = {
        name: (fmean(found[p] for p in PAIR_SETS), geometric_mean([found[kind] for kind in SEEN]))
        for name, found in means.items()
    }
    left, top, wide, high = 72, 52, 520, 330
    drawing = Drawing(left + wide + 190, top + high + 56, "SNR against visible error by aim")
    drawing.text(left, 28, "What an aim moves: SNR under single lights, and what is seen", "title")
    snr, seen = ([place[index] for place in at.values()] for index in range(2))
    x = Axis(math.floor(min(snr) - 0.5), math.ceil(max(snr) + 0.5), left, left + wide)
    y = Axis(0.9 * min(seen), 1.1 * max(seen), top, top + high)
    drawing.grid(x, y)
    drawing.text(left + wide / 2, top + high + 38, "mean SNR (dB), to the right is better", "dim middle")
    drawing.text(20, top + high / 2, "visible error, upwards is better", "dim middle", turned=True)
    aims = [place for name, place in at.items() if name.startswith(_AIM)]
    for (x1, y1), (x2, y2) in itertools.pairwise(aims):
        drawing.line(x(x1), y(y1), x(x2), y(y2), "zero")
    places = spread([y(second) for _, second in at.values()], 13, top + 6, top + high - 4)
    for (name, (first, second)), place in zip(at.items(), places, strict=True):
        ours = name.startswith(_AIM)
        drawing.line(x(first) + 4, y(second), x(first) + 22, place)
        drawing.dot(x(first), y(second), 6 if ours else 4, "a" if ours else "rest", f"{first:.1f} dB, {second:.3f}")
        drawing.text(x(first) + 25, place + 4, name.removeprefix("auto, "), "ink" if ours else "dim")
    return drawing.to_svg()
