"""Writes docs/results.md from the JSON files of benchmarks/results.py.

    python docs/make_results_page.py RESULTS_FOLDER [PAGE]

Every sentence with a figure in it is made from the files too.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mipbake.compare.result import SCALES
from mipbake.metrics import MEASURES, PAIR_SETS, mean_interval
from mipbake.prefilter import METHODS

PAGE = Path(__file__).resolve().parent / "results.md"
SUBJECT, OPTIMUM, LINEAR = "neural", "optimum", "linear (box)"
FOUR = ("linear (box)", "linear (gaussian)", "lean (box)", "lean (gaussian)")
LODS = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0)
PLACES = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere", "sphere": "sphere", "plane": "plane"}
DIGITS = {
    "snr": 1,
    "tonemapped": 4,
    "flip": 3,
    "hdr-flip": 3,
    "delta-e-itp": 2,
    "ssim": 3,
    "flicker": 2,
    "flicker-snr": 1,
}

_LIMIT = """\
On the middle {side} x {side} texels of each of {sets} sets, where every texel of every level is optimised against
the reference (`mipbake bake --method optimum`): what a stack of one lobe a texel can reach. It is a lower bound on
that limit: the descent ends after 40 rounds where it has not settled before, and what it keeps is judged on other
pairs than those of this table, while the oracle, the best of fourteen closed forms for every set and level, is
picked on them. {shortfall} The closed gap is how much of the way from that oracle to the optimum neural goes;
negative where it is behind the oracle.
"""

Key = tuple[str, str, str, str]
"""Method, measure, view and scale."""


@dataclass(frozen=True)
class Results:
    """The files of one kind, a set each.

    Args:
        sets: their names.
        methods: in the order of the files, the subject first.
        curve: method, pair set and lod to a figure a set. figures: the same of every measure and scale.
        scenes: of all sets, as in the files.
        seconds: that each method took to bake each set.
    """

    sets: list[str]
    methods: list[str]
    curve: Mapping[tuple[str, str, float], np.ndarray]
    figures: Mapping[Key, np.ndarray]
    scenes: Sequence[Mapping[str, Any]]
    seconds: Mapping[str, Sequence[float]]

    @property
    def lods(self) -> list[float]:
        """Levels of detail of tables: LODS, as far as they were measured, and the last that was."""
        every = sorted({lod for _, _, lod in self.curve})
        return [lod for lod in every if lod in LODS or lod == every[-1]]

    def closed_forms(self) -> list[str]:
        """Methods that average."""
        return [name for name in self.methods if METHODS[name.split(" (")[0]].averages]


def read(folder: Path) -> Results:
    files = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    if not files:
        raise SystemExit(f"{folder} holds no results: run benchmarks/results.py first")
    curve: dict[tuple[str, str, float], list[float]] = {}
    figures: dict[Key, list[float]] = {}
    for file in files:
        for f in file["curve"]:
            curve.setdefault((f["method"], f["view"], f["lod"]), []).append(f["value"])
        for f in file["figures"]:
            figures.setdefault((f["method"], f["measure"], f["view"], f["scale"]), []).append(f["value"])
    curve, figures = ({k: v for k, v in found.items() if len(v) == len(files)} for found in (curve, figures))
    return Results(
        [file["name"] for file in files],
        [method["name"] for method in files[0]["methods"]],
        {key: np.array(values, np.float64) for key, values in curve.items()},
        {key: np.array(values, np.float64) for key, values in figures.items()},
        [scene for file in files for scene in file["scenes"]],
        {
            m["name"]: [o["seconds"] for f in files for o in f["methods"] if o["name"] == m["name"]]
            for m in files[0]["methods"]
        },
    )


def table(first: str, heads: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    lines = [f"| {first} | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    return "\n".join([*lines, *(f"| {name} | " + " | ".join(cells) + " |" for name, cells in rows.items())]) + "\n"


def average(measure: str, values: np.ndarray) -> tuple[float, float, float]:
    """Mean and its 95 % interval over sets; of flicker, a ratio, the geometric mean. Sets without a figure are "
    "left out."""
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


def by_lod(results: Results, pairs: str) -> str:
    """Mean SNR by level of detail; the best of each column is bold."""
    means = {name: [results.curve[name, pairs, lod].mean() for lod in results.lods] for name in results.methods}
    means = {name: [*row, float(np.mean(row))] for name, row in means.items()}
    heads = [*(f"{lod:g}" for lod in results.lods), "mean"]
    best = [max(row[i] for name, row in means.items() if name != OPTIMUM) for i in range(len(heads))]
    rows = {
        name: [f"**{v:.1f}**" if v == b and name != OPTIMUM else f"{v:.1f}" for v, b in zip(row, best, strict=True)]
        for name, row in means.items()
    }
    return table(pairs, heads, rows)


def by_scale(results: Results, measure: str, view: str) -> str:
    """Means over sets with intervals, by scale; the best of each column is bold. Empty where nothing was measured."""
    scales = [s for s in (*SCALES, "") if (SUBJECT, measure, view, s) in results.figures]
    found = (
        {
            name: [average(measure, results.figures[name, measure, view, scale]) for scale in scales]
            for name in results.methods
            if (name, measure, view, scales[0]) in results.figures
        }
        if scales
        else {}
    )
    if not found:
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
    return table("", [scale or "all scales" for scale in scales], shown)


def heading(measure: str, view: str) -> str:
    about = MEASURES[measure]
    better = {"higher": "higher is better", "lower": "lower is better", "one": "1 is right"}[about.direction]
    unit = f"{about.unit}, " if about.unit else ""
    return f"#### {about.title}, {PLACES.get(view, view)} ({unit}{better})\n"


def outcome(results: Results, measure: str, view: str, scale: str) -> list[str] | None:
    """Subject against the closed form with the best mean: which, both means, the difference with its interval."""
    if (SUBJECT, measure, view, scale) not in results.figures:
        return None
    rivals = [name for name in results.closed_forms() if (name, measure, view, scale) in results.figures]
    means = {name: average(measure, results.figures[name, measure, view, scale])[0] for name in rivals}
    rival = min(means, key=lambda name: loss(measure, means[name]))
    own, other = (results.figures[name, measure, view, scale] for name in (SUBJECT, rival))
    better = np.array([loss(measure, b) - loss(measure, a) for a, b in zip(own, other, strict=True)])
    better = better[np.isfinite(better)]
    if len(better) < 2:
        return None
    gain = mean_interval(better)
    who = SUBJECT if gain.low > 0 else rival if gain.high < 0 else "neither"
    digits = DIGITS[measure]
    return [
        f"{average(measure, own)[0]:.{digits}f}",
        f"{means[rival]:.{digits}f} ({rival})",
        f"{gain.estimate:+.{digits}f} ({gain.low:+.{digits}f} to {gain.high:+.{digits}f})",
        f"{int((better > 0).sum())} of {len(better)}",
        f"**{who}**" if who == SUBJECT else who,
    ]


def winners(results: Results) -> str:
    rows = {}
    for measure in MEASURES:
        for view in (*PAIR_SETS, "sphere", "plane", "rotation"):
            for scale in (*SCALES, ""):
                row = outcome(results, measure, view, scale)
                if row:
                    rows[f"{MEASURES[measure].title}, {PLACES.get(view, view)}, {scale or 'all scales'}"] = row
    heads = [SUBJECT, "best closed form", "difference, better positive", "sets where neural is better", "ahead"]
    return table("measure, view, scale", heads, rows)


def per_set(results: Results, value: Callable[[str, float, int], float], pairs: str) -> str:
    lods = results.lods
    rows = {name: [f"{value(pairs, lod, index):+.1f}" for lod in lods] for index, name in enumerate(results.sets)}
    return table(pairs, [f"{lod:g}" for lod in lods], rows)


def best_of(results: Results, pairs: str, lod: float) -> np.ndarray:
    """The best closed form of every set: an oracle, (sets,)."""
    return np.max([results.curve[name, pairs, lod] for name in results.closed_forms()], 0)


def against_four(results: Results, pairs: str) -> str:
    """Measured methods against the best of FOUR for every set and level: mean gains, the worst, how many lose."""
    rows = {}
    for name in (name for name in results.methods if name not in results.closed_forms()):
        gains = np.stack(
            [
                results.curve[name, pairs, lod] - np.max([results.curve[form, pairs, lod] for form in FOUR], 0)
                for lod in results.lods
            ],
            1,
        )
        at, lod = np.unravel_index(gains.argmin(), gains.shape)
        rows[name] = [
            *(f"{gain:+.1f}" for gain in gains.mean(0)),
            f"{gains.mean():+.2f}",
            f"{gains.min():+.1f} ({results.sets[int(at)]}, {results.lods[int(lod)]:g})",
            f"{int((gains < -1).sum())}, {int((gains < -0.25).sum())} of {gains.size}",
        ]
    heads = [*(f"{lod:g}" for lod in results.lods), "mean", "worst (set, lod)", "below -1 dB, below -0.25 dB"]
    return table(pairs, heads, rows)


def pictures_won(results: Results) -> str:
    """In how many pictures of spheres, of a set at a scale, FLIP is below that of every closed form."""
    rows = {}
    for name in (name for name in results.methods if name not in results.closed_forms()):
        scales = [scale for scale in SCALES if (name, "flip", "sphere", scale) in results.figures]
        least = {
            s: np.min([results.figures[f, "flip", "sphere", s] for f in results.closed_forms()], 0) for s in scales
        }
        won = [results.figures[name, "flip", "sphere", scale] < least[scale] for scale in scales]
        if won:
            rows[name] = [*(f"{int(w.sum())} of {w.size}" for w in won), f"{np.mean(won):.0%}"]
    return table("FLIP below every closed form", [*SCALES, "all"], rows)


def costs(results: Results) -> str:
    """What a method takes and what it gives."""
    rows = {}
    for name in results.methods:
        means = [np.mean([results.curve[name, pairs, lod] for lod in results.lods]) for pairs in PAIR_SETS]
        seconds = results.seconds[name]
        rows[name] = [f"{np.median(seconds):.1f}", f"{max(seconds):.1f}", *(f"{mean:.1f}" for mean in means)]
    return table("", ["seconds a set, median", "longest", *(f"SNR {pairs}" for pairs in PAIR_SETS)], rows)


def gaps(results: Results) -> str:
    """Closed gap by pair set and lod: (subject - best) / (optimum - best) of the means over sets."""
    rows = {}
    for pairs in PAIR_SETS:
        lods = results.lods
        best = [best_of(results, pairs, lod).mean() for lod in lods]
        own, top = ([results.curve[name, pairs, lod].mean() for lod in lods] for name in (SUBJECT, OPTIMUM))
        rows[f"{pairs}: best closed form of each set"] = [f"{b:.1f}" for b in best]
        rows[f"{pairs}: neural"] = [f"{o:.1f}" for o in own]
        rows[f"{pairs}: optimum"] = [f"{t:.1f}" for t in top]
        rows[f"{pairs}: closed gap"] = [
            f"{(o - b) / (t - b):.0%}" if t - b > 0.05 else "" for b, o, t in zip(best, own, top, strict=True)
        ]
    return table("dB", [f"{lod:g}" for lod in results.lods], rows)


def shortfall(results: Results) -> str:
    """A sentence on where the optimum is behind the oracle: there it is no limit."""
    behind = [
        gain
        for pairs in PAIR_SETS
        for lod in results.lods
        for gain in results.curve[OPTIMUM, pairs, lod] - best_of(results, pairs, lod)
    ]
    lost = [gain for gain in behind if gain < -0.25]
    return (
        f"In {len(lost)} of the {len(behind)} cells of set, level and pair set it is behind that oracle by more than "
        f"0.25 dB, by {-min(behind):.1f} at worst: there it is no limit."
    )


def text(folder: Path) -> str:
    whole = read(folder / "whole")
    converged = sum(scene["converged"] for scene in whole.scenes)
    parts = [
        "# Results\n",
        f"Every method on {len(whole.sets)} real texture sets that training never saw (those of the README), isotropic "
        "glTF target, Gaussian pixel filter, measured as `mipbake compare` measures ([validation](validation.md) says "
        "what each figure means). Made by `benchmarks/results.py` and `docs/make_results_page.py`; nothing here "
        "is typed in. "
        f"Of the {len(whole.scenes)} references of renders {converged} reached a standard error of a tenth of the "
        "best candidate's error; the noise of the others counts as error in every measure of a render but SNR and "
        "flicker.\n",
        "Intervals are 95 % over texture sets: how far a mean would move with other sets of the same kind. Bold "
        "is the best "
        "of a column.\n",
        "## Who wins where\n",
        "Neural against the closed form with the best mean of that very measure and scale, which is another one "
        "from line to "
        "line: stricter than any single rule could be. The difference is the mean over sets, of flicker that of the "
        "logarithm's distance from 1; somebody is ahead where its interval does not hold 0.\n",
        winners(whole),
        "## Against the best of four\n",
        "The best of `linear` and `lean`, each with the box and with the pixel filter, picked for every set and level "
        "with the figures in hand. Means over sets of the difference in dB.\n",
        *(against_four(whole, pairs) for pairs in PAIR_SETS),
        pictures_won(whole),
        "## SNR by level of detail\n",
        *(by_lod(whole, pairs) for pairs in PAIR_SETS),
        "## What it costs\n",
        "Seconds to bake a set with the machine of the measurement, two cores that other work shared: orders of "
        "magnitude, not benchmarks. SNR is the mean over sets and levels of detail in dB.\n",
        costs(whole),
        "## Every measure by scale\n",
        "In texture space, under single lights:\n",
    ]
    for views in (tuple(PAIR_SETS), ("sphere",), ("plane",), ("rotation",)):
        if views == ("sphere",):
            parts.append("### In renders under the studio's lights\n")
        for measure in MEASURES:
            for view in views:
                made = by_scale(whole, measure, view)
                parts += [heading(measure, view), made] if made else []
    parts += [
        "## Per set: SNR over `linear (box)`, in dB\n",
        *(
            per_set(whole, lambda p, lod, i: whole.curve[SUBJECT, p, lod][i] - whole.curve[LINEAR, p, lod][i], pairs)
            for pairs in PAIR_SETS
        ),
        "## Per set: SNR over the best closed form of each set and level, in dB\n",
        *(
            per_set(whole, lambda p, lod, i: whole.curve[SUBJECT, p, lod][i] - best_of(whole, p, lod)[i], pairs)
            for pairs in PAIR_SETS
        ),
    ]
    if (folder / "crop").is_dir():
        crop = read(folder / "crop")
        side = json.loads(next((folder / "crop").glob("*.json")).read_text())["settings"]["crop"]
        parts += [
            "## The limit: the per-material optimum\n",
            _LIMIT.format(side=side, sets=len(crop.sets), shortfall=shortfall(crop)),
            gaps(crop),
            *(by_lod(crop, pairs) for pairs in PAIR_SETS),
            "### Per set: optimum over the best closed form of each set and level, in dB\n",
            *(
                per_set(crop, lambda p, lod, i: crop.curve[OPTIMUM, p, lod][i] - best_of(crop, p, lod)[i], pairs)
                for pairs in PAIR_SETS
            ),
        ]
    return "\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description="the page of results")
    parser.add_argument("results", type=Path)
    parser.add_argument("page", type=Path, nargs="?", default=PAGE)
    options = parser.parse_args()
    options.page.write_text(text(options.results), encoding="utf-8")


if __name__ == "__main__":
    main()
