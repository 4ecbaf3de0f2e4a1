"""Blocks of the README made from the records of benchmarks/results.py and of three.js.

What is said holds whatever the figures are: counts and ranges, and no word on who is ahead that is not counted.
"""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np
from results_page.files import FOUR, LINEAR, OPTIMUM, SUBJECT, Results, read
from results_page.models import targets
from results_page.standing import closed_gap, won
from results_page.tables import average, by_lod

from mipbake.metrics import PAIR_SETS
from records.missing import Missing

if TYPE_CHECKING:
    from records.making import Records

SHOWN = (
    SUBJECT,
    "auto",
    "linear (box)",
    "linear (gaussian)",
    "lean (box)",
    "lean (gaussian)",
    "godot (gaussian)",
    "unreal (gaussian)",
)
LEARNED = (SUBJECT, "auto")
_NEAR, _OVER = PAIR_SETS


def results_table(records: Records, pairs: str) -> str:
    """Mean SNR by level of detail of the methods of the README, and of the oracle."""
    results = _of(records, "whole")
    oracle = [results.best_of(pairs, lod, FOUR).mean() for lod in results.lods]
    cells = " | ".join(f"{value:.1f}" for value in (*oracle, fmean(oracle)))
    made = by_lod(results, pairs, [name for name in SHOWN if name in results.methods])
    return f"\n{made}| best of linear and lean for each set and level | {cells} |\n"


def where_it_wins(records: Records) -> str:
    results = _of(records, "whole")
    ahead = {name: _ahead(results, name) for name in LEARNED}
    cells = len(results.lods) * len(PAIR_SETS)
    near, over = ([float(np.mean(g)) for g in results.gains(SUBJECT, pairs, (LINEAR,)).T] for pairs in PAIR_SETS)
    gains = {name: [results.gains(name, pairs, FOUR).mean() for pairs in PAIR_SETS] for name in LEARNED}
    seen = {name: float(np.mean([*won(results, name).values()])) for name in LEARNED}
    return (
        "**Where it wins.** In the mean over sets the network alone is ahead of every closed form at "
        f"{ahead[SUBJECT]} of {cells} levels and pair sets, and `auto`, which is what `mipbake bake` does, at "
        f"{ahead['auto']}. Over `linear` with the box, which is what engines do, the network gains {min(near):.1f} to "
        f"{max(near):.1f} dB near the mirror and {min(over):.1f} to {max(over):.1f} dB over the hemisphere. Against "
        "an oracle that picks the best of `linear` and `lean`, each with the box and with the pixel filter, for "
        f"every set and level with the figures in hand, the network gains {gains[SUBJECT][0]:.1f} and "
        f"{gains[SUBJECT][1]:.1f} dB in the mean, and `auto` {gains['auto'][0]:.1f} and {gains['auto'][1]:.1f} dB. As "
        "pictures, spheres under a studio's lights are nearer to the reference by FLIP than with each of the "
        f"{len(results.closed_forms)} closed forms in {seen[SUBJECT]:.0%} of sets and scales with the network, and in "
        f"{seen['auto']:.0%} with `auto`."
    )


def where_it_loses(records: Records) -> str:
    results = _of(records, "whole")
    lost = {(name, pairs): results.gains(name, pairs, FOUR) for name in LEARNED for pairs in PAIR_SETS}
    count = {key: int((gains < -1).sum()) for key, gains in lost.items()}
    worst = lost[SUBJECT, _NEAR].min(1)
    named = [f"`{results.sets[i]}` by up to {-worst[i]:.1f} dB" for i in np.argsort(worst)[:2] if worst[i] < -1]
    far = won(results, SUBJECT)["far"]
    flicker = {
        name: average("flicker", results.figures[name, "flicker", _OVER, "near"])[0]
        for name in (SUBJECT, "vmf (gaussian)", LINEAR)
    }
    return (
        f"**Where it loses.** Behind that oracle by more than 1 dB the network is in {count[SUBJECT, _NEAR]} of "
        f"{lost[SUBJECT, _NEAR].size} sets at levels near the mirror{_listed(named)}, and in {count[SUBJECT, _OVER]} "
        f"over the hemisphere; `auto` is in {count['auto', _NEAR]} and {count['auto', _OVER]}. On rough sets a single "
        "grazing pair of light and view often decides ([docs/research.md](docs/research.md)). From far away the FLIP "
        f"of the network is below that of every closed form in {int(far.sum())} of {far.size} sets. Levels that are "
        "sharp enough for still pictures flicker more at the near scales: over the hemisphere, near, the network "
        f"changes {flicker[SUBJECT]:.1f} times as much as it should, `vmf` with the pixel filter "
        f"{flicker['vmf (gaussian)']:.2f} times and `linear` with the box {flicker[LINEAR]:.1f} times."
    )


def optimum_left(records: Records) -> str:
    results = _of(records, "crop")
    side = results.files[0]["crop"]
    top = [results.gains(OPTIMUM, pairs, FOUR).mean() for pairs in PAIR_SETS]
    refine = next(name for name, each in results.methods.items() if each["method"] == "refine")
    closed = {name: [closed_gap(results, name, pairs) for pairs in PAIR_SETS] for name in (SUBJECT, refine)}
    beyond = (
        " More than all of it means that the optimum, which is settled by other light-view pairs than those of the "
        "table, is not quite one."
        if max(closed[refine]) > 1
        else ""
    )
    return (
        f"**How much is left.** On the middle {side} x {side} texels of these sets every texel was optimised until "
        f"nothing improved: what one lobe a texel can do is {top[0]:.1f} dB above that oracle near the mirror and "
        f"{top[1]:.1f} dB over the hemisphere. Of this gap the network closes {closed[SUBJECT][0]:.0%} and "
        f"{closed[SUBJECT][1]:.0%}, and `--method refine`, with the time that two minutes for 512 x 512 texels leave, "
        f"{closed[refine][0]:.0%} and {closed[refine][1]:.0%}.{beyond}"
    )


def directional_gain(records: Records) -> str:
    results = _of(records, "directional")
    _, plain, rich = next(each for each in targets(results) if each[0] == SUBJECT)
    gains = {
        pairs: np.stack([results.curve[rich, pairs, lod] - results.curve[plain, pairs, lod] for lod in results.lods], 1)
        for pairs in PAIR_SETS
    }
    near = gains[_NEAR].mean(1)
    return (
        f"On {len(results.sets)} sets whose bumps run in one direction, `--target gltf-anisotropic`, which stores two "
        f"widths for each lobe, changes the network's SNR by {gains[_NEAR].mean():+.1f} dB near the mirror and "
        f"{gains[_OVER].mean():+.1f} over the hemisphere in the mean; by set it is {near.min():+.1f} to "
        f"{near.max():+.1f} dB near the mirror."
    )


def in_three(records: Records) -> str:
    cells = [cell for cell in records["engines-three"]["cells"] if cell["container"] == "ktx2-rgba8"]
    views = {(cell["set"], cell["view"]) for cell in cells}
    sets = len({cell["set"] for cell in cells})
    found = {name: _beside_linear(cells, name) for name in LEARNED}
    better = {name: sum(gain > 0 for gain, _, _ in each) for name, each in found.items()}
    gains = {name: [gain for gain, _, _ in each] for name, each in found.items()}
    flip = {name: sum(change < 0 for _, change, _ in each) for name, each in found.items()}
    at = {scale: [change for _, change, where in found["auto"] if where == scale] for scale in ("far", "near")}
    return (
        "**In other renderers.** In three.js, whose shading and filtering nobody here wrote, against three.js "
        f"supersampled: {len(views)} views of {sets} sets, a receding plane, a wall seen straight on and a sphere, at "
        f"four distances. The network's levels have a better SNR than averaged ones in {better[SUBJECT]} of them, by "
        f"{fmean(gains[SUBJECT]):.1f} dB in the mean ({min(gains[SUBJECT]):+.1f} to {max(gains[SUBJECT]):+.1f}); "
        f"`auto` in {better['auto']}, by {fmean(gains['auto']):.1f} ({min(gains['auto']):+.1f} to "
        f"{max(gains['auto']):+.1f}). FLIP is lower in {flip[SUBJECT]} and {flip['auto']} of {len(views)}: far away "
        f"in {sum(c < 0 for c in at['far'])} of {len(at['far'])} (`auto`), near in {sum(c < 0 for c in at['near'])} "
        f"of {len(at['near'])}. Trilinear lookups blur by the longer side of a footprint, so surfaces seen at an "
        "angle come out soft already, and there the pixel filter in level 0 adds to it. [All "
        "cells](benchmarks/engines/RESULTS.md), and the same levels sampled by Filament, OpenImageIO and Cycles: "
        "[benchmarks/engines](benchmarks/engines/README.md)."
    )


def _beside_linear(cells: list[dict[str, Any]], name: str) -> list[tuple[float, float, str]]:
    """Gain in dB, change in FLIP as it is shown, and scale, of every view."""
    linear = {(cell["set"], cell["view"]): cell for cell in cells if cell["candidate"] == "linear"}
    own = [cell for cell in cells if cell["candidate"] == name]
    pairs = [(cell, linear[cell["set"], cell["view"]]) for cell in own]
    return [(a["snr"] - b["snr"], round(a["flip"], 4) - round(b["flip"], 4), a["scale"]) for a, b in pairs]


def _ahead(results: Results, name: str) -> int:
    """At how many levels and pair sets the mean is above that of every closed form."""
    return sum(
        results.curve[name, pairs, lod].mean() > max(results.curve[f, pairs, lod].mean() for f in results.closed_forms)
        for pairs in PAIR_SETS
        for lod in results.lods
    )


def _listed(named: list[str]) -> str:
    return f" ({', '.join(named)})" if named else ""


def _of(records: Records, kind: str) -> Results:
    found = read(records.folder, kind)
    if found is None:
        raise Missing(f"results-{kind}")
    return found
