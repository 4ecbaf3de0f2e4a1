"""The section of docs/results.md about `--aim`: the front between decibels and visible errors, and its limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from statistics import fmean, geometric_mean

from records.record import load
from records.wrapping import table

from mipbake.quality.metrics.pairs import PAIR_SETS
from results_page.tables import PLACES

LIMIT, PLAIN = "limit of the visible error", "linear (box)"
_SHOWN = {"optimum": "limit of the SNR"}
_AIM, _BEST = "auto, aim ", "best closed form"

_WORDS = """\
On the middle {side} x {side} texels of each of {sets} sets, `auto` was baked with several aims, for the sampler
`trilinear`. SNR is in dB. The other columns have the [visible error](method.md#the-visible-error) of small pictures
that face the viewer and of slanted ones; less is better. Figures are means over levels of detail and sets, of visible
errors the geometric means. Two descents of 40 rounds show the limits. The best closed form is an oracle, of {forms}
closed forms for every set and column. The last column says how much of the way from it to the limit of the visible
error a method goes, in the logarithm.
"""

Figures = Mapping[str, Mapping[str, float]]


def section(folder: Path) -> list[str]:
    """Heading, words and table; nothing where there is no record."""
    record = load("aims", folder)
    if record is None:
        return []
    sets: Mapping[str, Figures] = record.data["sets"]
    forms = [name for name in next(iter(sets.values())) if _is_form(name)]
    columns = next(iter(next(iter(sets.values())).values()))
    means = _means(sets)
    rows = [
        [
            _SHOWN.get(name, name),
            *(f"{found[key]:.{1 if key in PAIR_SETS else 3}f}" for key in columns),
            _way(means, name),
        ]
        for name, found in means.items()
    ]
    pictures = (f"visible error, {name.rpartition(', ')[2]}" for name in columns if name not in PAIR_SETS)
    heads = ["", *(f"SNR {PLACES[pairs]}" for pairs in PAIR_SETS), *pictures, "share of the way"]
    return [
        "## Aims: decibels against visible errors\n",
        _WORDS.format(side=record.data["side"], sets=len(sets), forms=len(forms)),
        table(heads, rows) + "\n",
    ]


def _is_form(name: str) -> bool:
    return name.endswith((" (box)", " (gaussian)"))


def _means(sets: Mapping[str, Figures]) -> dict[str, dict[str, float]]:
    """Method to its means over sets: PLAIN, the best closed form of every set and column, and all other methods."""
    every = [{**found, _BEST: _best(found)} for found in sets.values()]
    names = [PLAIN, _BEST, *(name for name in next(iter(sets.values())) if not _is_form(name))]
    return {name: {key: _mean(key)([found[name][key] for found in every]) for key in every[0][name]} for name in names}


def _best(found: Figures) -> dict[str, float]:
    """The most SNR of all closed forms of a set, and the least visible error."""
    forms = [figures for name, figures in found.items() if _is_form(name)]
    return {key: (max if key in PAIR_SETS else min)(form[key] for form in forms) for key in forms[0]}


def _mean(key: str) -> Callable[[Iterable[float]], float]:
    return fmean if key in PAIR_SETS else geometric_mean


def _way(means: Figures, name: str) -> str:
    """Empty but for the aims and the network."""
    if not name.startswith((_AIM, "neural")):
        return ""
    start, own, end = (
        fmean(math.log(error) for key, error in means[each].items() if key not in PAIR_SETS)
        for each in (_BEST, name, LIMIT)
    )
    return f"{(start - own) / (start - end):.0%}"
