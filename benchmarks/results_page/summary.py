"""The summary at the top of the page of results, in sentences.

What is said holds whatever the figures are: counts and ranges, and no word on who is ahead that is not counted.
"""

from __future__ import annotations

from statistics import fmean

import numpy as np

from mipbake.quality.metrics import PAIR_SETS
from results_page.files import FOUR, LINEAR, OPTIMUM, SUBJECT, Results
from results_page.tables import average, closed_gap, targets, won

LEARNED = (SUBJECT, "auto")
_NEAR, _OVER = PAIR_SETS


def summary(whole: Results, crop: Results | None, directed: Results | None) -> list[str]:
    """Paragraphs on whole sets, on the limit and on the anisotropic target; a paragraph without results is left out."""
    parts = [_wins(whole), _loses(whole)]
    if crop is not None and OPTIMUM in crop.methods:
        parts.append(_left(crop))
    if directed is not None and SUBJECT in (name for name, _, _ in targets(directed)):
        parts.append(_directional(directed))
    return [f"{part}\n" for part in parts]


def _wins(results: Results) -> str:
    ahead = {name: _ahead(results, name) for name in LEARNED}
    cells = len(results.lods) * len(PAIR_SETS)
    near, over = ([float(np.mean(g)) for g in results.gains("auto", pairs, (LINEAR,)).T] for pairs in PAIR_SETS)
    seen = {name: fmean(float(np.mean(each)) for each in won(results, name).values()) for name in LEARNED}
    return (
        f"**Where it wins.** There are {len(results.lods)} levels of detail and {len(PAIR_SETS)} pair sets, {cells} "
        f"cases. The mean SNR of `auto` is above the mean SNR of every closed form in {ahead['auto']} of these cases, "
        f"and the mean SNR of the network in {ahead[SUBJECT]}. Over `{LINEAR}` `auto` gains "
        f"{min(near):.1f} to {max(near):.1f} dB near the mirror and {min(over):.1f} to {max(over):.1f} dB over the "
        "hemisphere, depending on the level. Pictures of spheres under a studio's lights are compared by FLIP, in "
        f"{sum(each.size for each in won(results, SUBJECT).values())} cases of set and scale. `auto` is nearer to the "
        f"reference than each of the {len(results.closed_forms)} closed forms in {seen['auto']:.0%} of these cases, "
        f"and the network in {seen[SUBJECT]:.0%}."
    )


def _loses(results: Results) -> str:
    lost = {(name, pairs): results.gains(name, pairs, FOUR) for name in LEARNED for pairs in PAIR_SETS}
    count = {key: int((gains < -1).sum()) for key, gains in lost.items()}
    far = won(results, "auto")["far"]
    flicker = {
        name: average("flicker", results.figures[name, "flicker", _OVER, "near"])
        for name in ("auto", "vmf (gaussian)", LINEAR)
    }
    return (
        f"**Where it loses.** There are {lost[SUBJECT, _NEAR].size} cases of set and level. Near the mirror `auto` is "
        f"more than 1 dB behind the best of four in {count['auto', _NEAR]} cases, and over the hemisphere in "
        f"{count['auto', _OVER]}. The network is that far behind in {count[SUBJECT, _NEAR]} and "
        f"{count[SUBJECT, _OVER]} cases. From far away the FLIP of `auto` is below the FLIP of every closed form in "
        f"{int(far.sum())} of {far.size} sets. Levels that are sharp enough for still pictures flicker more near the "
        f"viewer. Over the hemisphere the pixels of `auto` change {flicker['auto']:.1f} times as much as they should "
        f"there, the pixels of `vmf (gaussian)` {flicker['vmf (gaussian)']:.2f} times, and the pixels of `{LINEAR}` "
        f"{flicker[LINEAR]:.1f} times."
    )


def _left(results: Results) -> str:
    top = [results.gains(OPTIMUM, pairs, FOUR).mean() for pairs in PAIR_SETS]
    refine = next(name for name, each in results.methods.items() if each["method"] == "refine")
    closed = [closed_gap(results, name, pairs) for name in (SUBJECT, refine) for pairs in PAIR_SETS]
    return (
        "**How much is left.** On small parts of the sets every texel was optimised until nothing improved. This "
        f"optimum is {top[0]:.1f} dB above the best of four near the mirror and {top[1]:.1f} dB over the hemisphere. "
        f"Of this gap the network closes {closed[0]} and {closed[1]}, and `{refine}` closes {closed[2]} and "
        f"{closed[3]}."
    )


def _directional(results: Results) -> str:
    _, plain, rich = next(each for each in targets(results) if each[0] == SUBJECT)
    near, over = (
        np.mean([results.curve[rich, pairs, lod] - results.curve[plain, pairs, lod] for lod in results.lods])
        for pairs in PAIR_SETS
    )
    return (
        f"**Two widths.** `--target gltf-anisotropic` stores two widths for each lobe. On {len(results.sets)} sets "
        f"whose bumps run in one direction it changes the network's SNR by {near:+.1f} dB near the mirror and "
        f"{over:+.1f} dB over the hemisphere in the mean."
    )


def _ahead(results: Results, name: str) -> int:
    """At how many levels and pair sets the mean is above the mean of every closed form."""
    return sum(
        results.curve[name, pairs, lod].mean() > max(results.curve[f, pairs, lod].mean() for f in results.closed_forms)
        for pairs in PAIR_SETS
        for lod in results.lods
    )
