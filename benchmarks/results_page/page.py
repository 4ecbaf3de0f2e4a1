"""The text of docs/results.md, and its charts, from the records of benchmarks/results.py.

`python docs/remake.py` writes both. Every sentence with a figure in it is made from the records too. Kinds of
measurements that are not there have no section.
"""

from __future__ import annotations

from pathlib import Path

from records.wrapping import wrapped_page

from mipbake.quality.metrics import MEASURES, PAIR_SETS
from results_page import aims, charts, directional, standing, tables
from results_page.files import FOUR, LINEAR, OPTIMUM, SUBJECT, Results, read
from results_page.summary import summary

_INTRODUCTION = """\
Every method was measured on {sets} real texture sets that training never saw, with the target `gltf` and the Gaussian
pixel filter. {weights}[Validation](validation.md) says what each figure means, and the [glossary](glossary.md)
explains the terms. `python docs/remake.py` makes this page from the records in `benchmarks/records`.

Figures of texture space come from {points} pixels for each level of detail and 1,024 light-view pairs of each pair
set. Each of the two estimates of the reference takes {samples} samples a pixel. Renders are spheres of {side} x {side}
pixels. They have {scenes} references. {converged} of them reached a standard error of at most a tenth of the error of
the best candidate within {passes} samples a pixel. The noise of the other references counts as error in every measure
of a render but SNR, and makes good methods look a little worse. `mipbake compare` takes more samples by default.

Intervals are 95 % over texture sets. They say how far a mean would move with other sets of the same kind. Bold is the
best of a column. The **best of four** is an oracle: for every set and level it is the best of `linear` and `lean`, each
with the box and with the pixel filter.
"""

_COSTS = """\
Each bake ran in a process of its own on {threads}. Seconds are for the bake alone, with the import of what it
needs. The machine had other work, so compare processor seconds; wall seconds are an order of magnitude. Peak memory is
for the whole process. SNR is the mean over sets and levels.
"""

_LIMIT = """\
On the middle {side} x {side} texels of each of {sets} sets, every texel of every level is optimised against the
reference (`mipbake bake --method optimum`). This shows what a stack of one lobe a texel can reach. It is a lower bound
of that limit. The descent ends after 40 rounds, settled or not, and pairs that are not in this table decide what it
keeps. The best of four is picked on the pairs of this table. {shortfall} The closed gap is how much of the way from the
best of four to the optimum a method goes, in the means over sets. It is negative where the method is behind the best
of four, and above 100 % where it is ahead of the optimum. `refine` has the time that two minutes for a set of 512 x 512
texels leave for so many texels.
"""


def _ahead(whole: Results, page: Path) -> list[str]:
    """Who wins where."""
    parts = [
        "## Who wins where\n",
        "Each line compares the network with the closed form that has the best mean of that very measure and scale. "
        "Lines have different closed forms, so this is stricter than a comparison with any one of them. The difference "
        "is the mean over sets. For flicker it is the mean of the distance of the logarithm from 0. A method is ahead "
        "where the interval of the difference does not hold 0.\n",
        standing.winners(whole),
        "## Against the best of four\n",
        "Means over sets of the difference in dB.\n",
        *(standing.against_four(whole, pairs) for pairs in PAIR_SETS),
        standing.pictures_won(whole),
        "## Figure 5: how far ahead\n",
        "This is figure 5 of Kemppinen et al. (2023) on these sets. The histograms count sets and levels by how many "
        "dB a method is ahead of a closed form. They also count renders of spheres by how much lower the FLIP of the "
        "method is. FLIP stands in for LPIPS.\n",
    ]
    for name in whole.learned:
        file = f"results-figure-5-{name.replace(' ', '-')}.svg"
        words = f"{name}: ahead of closed forms by"
        (page.parent / file).write_text(charts.gain_histograms(whole, name, FOUR, words), encoding="utf-8")
        parts += [f"![Histograms of how far {name} is ahead of closed forms]({file})\n"]
        parts += [directional.gains_over(whole, name)]
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
        raise SystemExit(f"{folder} holds no results: run python docs/remake.py --measure results-whole first")
    effort, threads = whole.files[0]["key"]["effort"], whole.files[0]["threads"]
    gain = directional.anisotropy_gain(directed) if directed and directional.targets(directed) else None
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
        "## In short\n",
        *summary(whole, crop, directed),
        "## What was aimed at\n",
        standing.aims(whole, crop, gain),
        *_ahead(whole, page),
        "## SNR by level of detail\n",
        *(tables.by_lod(whole, pairs) for pairs in PAIR_SETS),
        "## In motion\n",
        f"This table is about sets that shimmer: the flicker of `{LINEAR}` is above {standing.SHIMMERS:g} there. Each "
        f"cell says in how many of these sets the flicker of a method is between {standing.STEADY[0]:g} and "
        f"{standing.STEADY[1]:g}, and from where to where it goes. Near is lod 0; 1:1 is the lods from 0 to 1.\n",
        standing.flicker(whole),
        "## What it costs\n",
        _COSTS.format(threads="one processor" if threads == 1 else f"{threads} processors"),
        "![SNR against bake time](results-cost.svg)\n",
        tables.costs(whole),
        *directional.directional(directed),
        *_limit(crop),
        *aims.section(folder, page),
        *_measures(whole),
        *_per_set(whole),
    ]
    return wrapped_page("\n".join(parts))
