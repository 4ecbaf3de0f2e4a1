"""The text of docs/results.md, from the records of benchmarks/results.py.

`python docs/remake.py` writes it. Every sentence with a figure in it is made from the records too. Kinds of
measurements that are not there have no section.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from records.wrapping import wrapped_page

from mipbake.quality.metrics import PAIR_SETS
from results_page import aims, tables
from results_page.files import OPTIMUM, SUBJECT, Results, read
from results_page.summary import summary

_INTRODUCTION = """\
Every method was measured on {sets} real texture sets that training never saw, with the target `gltf` and the Gaussian
pixel filter. {weights}[Validation](validation.md) says what each figure means. The
[records](../benchmarks/records) have the figures of every set, measure and kernel.

Figures of texture space come from {points} pixels for each level of detail and 1,024 light-view pairs of each pair
set, with {samples} samples a pixel in each of the two estimates of the reference. Renders are spheres of {side} x
{side} pixels. Of their {scenes} references {converged} reached a standard error of at most a tenth of the error of the
best candidate within {passes} samples a pixel. The noise of the others counts as error in every measure but SNR.

The **best of four** is an oracle: for every set and level it is the best of `linear` and `lean`, each with the box and
with the pixel filter.
"""

_AHEAD = """\
This table compares with the closed form that has the best mean of that very measure and scale. A cell has the mean
difference over sets; for flicker, of the distance of the logarithm from 0. It is bold where its 95 % interval over sets
is above 0, and in italics where the interval is below 0.
"""

_METHODS = """\
Flicker is over the hemisphere: how many times as much pixels change as they should. FLIP is of spheres. Bakes ran
on {threads}.
"""

_DIRECTIONAL = """\
These sets have an anisotropy map, or their slopes vary at least three times as much across their main direction as
along it in windows of 32 x 32 texels. {real} of them are real sets or examples; {generated} come from the project's
generator, and no training saw them. `gltf` stores one roughness; `gltf-anisotropic` stores a roughness, a strength and
a direction of anisotropy.
"""

_LIMIT = """\
On the middle {side} x {side} texels of each of {sets} sets, every texel of every level is optimised against the
reference (`mipbake bake --method optimum`). This is a lower bound of what a stack of one lobe a texel can reach.
{shortfall} The closed gap is how much of the way from the best of four to the optimum a method goes. `refine` has the
time that two minutes for a set of 512 x 512 texels leave for so many texels.
"""


def _directional(found: Results | None) -> list[str]:
    if found is None or not tables.targets(found):
        return []
    generated = sum(name.startswith("procedural-") for name in found.sets)
    return [
        "## Directional bumps: the anisotropic target\n",
        _DIRECTIONAL.format(real=len(found.sets) - generated, generated=generated),
        tables.two_widths(found),
    ]


def _limit(crop: Results | None) -> list[str]:
    if crop is None or OPTIMUM not in crop.methods:
        return []
    behind = np.concatenate([crop.gains(OPTIMUM, pairs).ravel() for pairs in PAIR_SETS])
    shortfall = (
        f"In {int((behind < -0.25).sum())} of the {behind.size} cases of set, level and pair set it is more than 0.25 "
        f"dB behind the best closed form, {behind.min():+.1f} dB at worst."
    )
    return [
        "## The limit: the per-material optimum\n",
        _LIMIT.format(side=crop.files[0]["crop"], sets=len(crop.sets), shortfall=shortfall),
        tables.gaps(crop),
    ]


def text(folder: Path, _page: Path) -> str:
    """The page of a folder of records."""
    whole, crop, directed = (read(folder, kind) for kind in ("whole", "crop", "directional"))
    if whole is None:
        raise SystemExit(f"{folder} holds no results: run python docs/remake.py --measure results-whole first")
    effort, threads = whole.files[0]["key"]["effort"], whole.files[0]["threads"]
    weights = whole.methods[SUBJECT]["weights"] if SUBJECT in whole.methods else None
    parts = [
        "# Results\n",
        _INTRODUCTION.format(
            sets=len(whole.sets),
            weights=f"`{SUBJECT}` is the network `{weights}`. " if weights else "",
            scenes=len(whole.scenes),
            converged=sum(scene["converged"] for scene in whole.scenes),
            **{name: effort[name] for name in ("points", "samples", "side", "passes")},
        ),
        "## In short\n",
        *summary(whole, crop, directed),
        "## SNR by level of detail\n",
        "Means over sets, in dB. Bold is the best of a column. With the box closed forms leave level 0 as it is, and "
        "`linear (box)` is what engines do.\n",
        *(tables.by_lod(whole, pairs) for pairs in PAIR_SETS),
        "## Ahead of the best closed form\n",
        _AHEAD,
        tables.winners(whole),
        "## In motion\n",
        _METHODS.format(threads="one processor" if threads == 1 else f"{threads} processors"),
        tables.methods(whole),
        *_directional(directed),
        *_limit(crop),
        *aims.section(folder),
    ]
    return wrapped_page("\n".join(parts))
