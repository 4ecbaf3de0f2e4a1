"""Makes docs/results.md, and its charts beside it, from the records of benchmarks/results.py.

`python docs/remake.py` writes it. Every sentence with a figure in it is made from the records too. Kinds of
measurements that are not there have no section.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from records.record import FOLDER
from results_page import charts, models, standing, tables
from results_page.files import FOUR, LINEAR, OPTIMUM, SUBJECT, Results, read

from mipbake.metrics import MEASURES, PAIR_SETS

PAGE = Path(__file__).resolve().parent / "results.md"

_INTRODUCTION = """\
Every method on {sets} real texture sets that training never saw (those of the README), isotropic glTF target, Gaussian
pixel filter; [validation](validation.md) says what each figure means. {weights}Made by `benchmarks/results.py` and
`docs/make_results_page.py`; nothing here is typed in. In texture space {points} pixels a level of detail, 1,024 pairs
of each kind and {samples} samples a pixel in each of two estimates; renders are spheres of {side} x {side} pixels. Of
their {scenes} references {converged} reached a standard error of a tenth of the best candidate's error with {passes}
samples a pixel; the noise of the others counts as error in every measure of a render but SNR.

Intervals are 95 % over texture sets: how far a mean would move with other sets of the same kind. Bold is the best of a
column. The best of four is the best of `linear` and `lean`, each with the box and with the pixel filter, picked for
every set and level with the figures in hand.
"""

_COSTS = """\
Each bake in a process of its own, which reads the set's channels from a file, on {threads}. Seconds are of the bake
alone, the import of what it needs included; the machine had other work, so processor seconds are the measure, and
wall seconds an order of magnitude. Peak memory is that of the whole process. SNR is the mean over sets and levels.
"""

_LIMIT = """\
On the middle {side} x {side} texels of each of {sets} sets, where every texel of every level is optimised against
the reference (`mipbake bake --method optimum`): what a stack of one lobe a texel can reach. It is a lower bound on
that limit: the descent ends after 40 rounds where it has not settled before, and what it keeps is judged on other
pairs than those of this table, while the oracle, the best closed form for every set and level, is picked on them.
{shortfall} The closed gap is how much of the way from the best of four to the optimum a method goes, of the means over
sets; negative where it is behind, above 100 % where it is ahead. `refine` has the time that two minutes for a set of
512 x 512 texels leave for so many.
"""


def _ahead(whole: Results, page: Path) -> list[str]:
    """Who wins where."""
    parts = [
        "## Who wins where\n",
        "Neural against the closed form with the best mean of that very measure and scale, which is another one from "
        "line to line: stricter than any single rule could be. The difference is the mean over sets, of flicker that "
        "of the logarithm's distance from 1; somebody is ahead where its interval does not hold 0.\n",
        standing.winners(whole),
        "## Against the best of four\n",
        "Means over sets of the difference in dB.\n",
        *(standing.against_four(whole, pairs) for pairs in PAIR_SETS),
        standing.pictures_won(whole),
        "## Figure 5: how far ahead\n",
        "As figure 5 of Kemppinen et al. 2023: of every set and level, how many dB a method is ahead of a closed form, "
        "and in renders of spheres how much lower its FLIP is, which stands in for LPIPS.\n",
    ]
    for name in whole.learned:
        file = f"results-figure-5-{name.replace(' ', '-')}.svg"
        words = f"{name}: ahead of closed forms by"
        (page.parent / file).write_text(charts.gain_histograms(whole, name, FOUR, words), encoding="utf-8")
        parts += [f"![Histograms of how far {name} is ahead of closed forms]({file})\n", models.gains_over(whole, name)]
    return parts


def _measures(whole: Results) -> list[str]:
    """Every measure by scale."""
    parts = ["## Every measure by scale\n", "### In texture space, under single lights\n"]
    for views in (tuple(PAIR_SETS), ("sphere",)):
        if views == ("sphere",):
            parts.append("### In renders of spheres under the studio's lights\n")
        for measure in MEASURES:
            for view in views:
                made = tables.by_scale(whole, measure, view)
                parts += [tables.heading(measure, view), made] if made else []
    return parts


def _per_set(whole: Results) -> list[str]:
    parts = ["## Per set: SNR of neural over `linear (box)`, in dB\n"]
    parts += [
        tables.per_set(whole, lambda p, lod: whole.curve[SUBJECT, p, lod] - whole.curve[LINEAR, p, lod], pairs)
        for pairs in PAIR_SETS
    ]
    for name in whole.learned:
        parts.append(f"## Per set: SNR of {name} over the best of four, in dB\n")
        parts += [
            tables.per_set(
                whole,
                lambda p, lod, name=name: whole.curve[name, p, lod] - whole.best_of(p, lod, FOUR),  # type: ignore[misc]
                pairs,
            )
            for pairs in PAIR_SETS
        ]
    return parts


def _limit(crop: Results | None) -> list[str]:
    if crop is None or OPTIMUM not in crop.methods:
        return []
    side, short = crop.files[0]["crop"], standing.shortfall(crop)
    return [
        "## The limit: the per-material optimum\n",
        _LIMIT.format(side=side, sets=len(crop.sets), shortfall=short),
        standing.gaps(crop),
        *(tables.by_lod(crop, pairs) for pairs in PAIR_SETS),
        "### Per set: optimum over the best closed form of each set and level, in dB\n",
        *(
            tables.per_set(crop, lambda p, lod: crop.curve[OPTIMUM, p, lod] - crop.best_of(p, lod), pairs)
            for pairs in PAIR_SETS
        ),
    ]


def text(folder: Path, page: Path) -> str:
    """The page; its charts are written beside it."""
    whole, crop, directed = (read(folder, kind) for kind in ("whole", "crop", "directional"))
    if whole is None:
        raise SystemExit(f"{folder} holds no results: run python docs/remake.py results-whole first")
    effort, threads = whole.files[0]["key"]["effort"], whole.files[0]["threads"]
    gain = models.anisotropy_gain(directed) if directed and models.targets(directed) else None
    for old in page.parent.glob("results-figure-5-*.svg"):  # of methods that may not be measured any more
        old.unlink()
    (page.parent / "results-cost.svg").write_text(charts.cost_chart(whole), encoding="utf-8")
    parts = [
        "# Results\n",
        _INTRODUCTION.format(
            sets=len(whole.sets),
            weights=tables.described(whole),
            scenes=len(whole.scenes),
            converged=sum(scene["converged"] for scene in whole.scenes),
            **{name: effort[name] for name in ("points", "samples", "side", "passes")},
        ),
        "## What was aimed at\n",
        standing.aims(whole, crop, gain),
        *_ahead(whole, page),
        "## SNR by level of detail\n",
        *(tables.by_lod(whole, pairs) for pairs in PAIR_SETS),
        "## In motion\n",
        f"Flicker of the sets where that of `{LINEAR}` is above {standing.SHIMMERS:g}: how many are between "
        f"{standing.STEADY[0]:g} and {standing.STEADY[1]:g}, and from where to where it goes. Near is lod 0, 1:1 lods "
        "0 to 1.\n",
        standing.flicker(whole),
        "## What it costs\n",
        _COSTS.format(threads="one processor" if threads == 1 else f"{threads} processors"),
        "![SNR against bake time](results-cost.svg)\n",
        tables.costs(whole),
        *models.directional(directed),
        *models.paper(folder, page),
        *models.correlated(folder),
        *_limit(crop),
        *_measures(whole),
        *_per_set(whole),
    ]
    return "\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description="the page of results")
    parser.add_argument("records", type=Path, nargs="?", default=FOLDER)
    parser.add_argument("page", type=Path, nargs="?", default=PAGE)
    options = parser.parse_args()
    options.page.write_text(text(options.records, options.page), encoding="utf-8")


if __name__ == "__main__":
    main()
