"""The summary at the top of the page of results, in sentences.

What is said holds whatever the figures are: counts and ranges, and no word on who is ahead that is not counted.
"""

from __future__ import annotations

from statistics import fmean

import numpy as np

from mipbake.quality.metrics import PAIR_SETS
from results_page.directional import targets
from results_page.files import FOUR, LINEAR, OPTIMUM, SUBJECT, Results
from results_page.standing import closed_gap, won
from results_page.tables import average

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
    near, over = ([float(np.mean(g)) for g in results.gains(SUBJECT, pairs, (LINEAR,)).T] for pairs in PAIR_SETS)
    gains = {name: [results.gains(name, pairs, FOUR).mean() for pairs in PAIR_SETS] for name in LEARNED}
    seen = {name: fmean(float(np.mean(each)) for each in won(results, name).values()) for name in LEARNED}
    return (
        "**Where it wins.** The network alone is `--method neural`. `auto` is the default; it mixes the network with "
        f"closed forms. There are {len(results.lods)} levels of detail and {len(PAIR_SETS)} pair sets, {cells} cases. "
        f"The mean SNR of the network is above the mean SNR of every closed form in {ahead[SUBJECT]} of these cases, "
        f"and the mean SNR of `auto` in {ahead['auto']}. `{LINEAR}` is what engines do. Over it the network gains "
        f"{min(near):.1f} to {max(near):.1f} dB near the mirror and {min(over):.1f} to {max(over):.1f} dB over the "
        "hemisphere, depending on the level. Over the best of four the network gains "
        f"{gains[SUBJECT][0]:.1f} and {gains[SUBJECT][1]:.1f} dB in the mean, and `auto` {gains['auto'][0]:.1f} and "
        f"{gains['auto'][1]:.1f} dB. Pictures of spheres under a studio's lights are compared by FLIP, in "
        f"{sum(each.size for each in won(results, SUBJECT).values())} cases of set and scale. The network is nearer "
        f"to the reference than each of the {len(results.closed_forms)} closed forms in {seen[SUBJECT]:.0%} of these "
        f"cases, and `auto` in {seen['auto']:.0%}."
    )


def _loses(results: Results) -> str:
    lost = {(name, pairs): results.gains(name, pairs, FOUR) for name in LEARNED for pairs in PAIR_SETS}
    count = {key: int((gains < -1).sum()) for key, gains in lost.items()}
    worst = lost[SUBJECT, _NEAR].min(1)
    named = [f"`{results.sets[i]}` by up to {-worst[i]:.1f} dB" for i in np.argsort(worst)[:2] if worst[i] < -1]
    listed = f" ({', '.join(named)})" if named else ""
    far = won(results, SUBJECT)["far"]
    flicker = {
        name: average("flicker", results.figures[name, "flicker", _OVER, "near"])[0]
        for name in (SUBJECT, "vmf (gaussian)", LINEAR)
    }
    return (
        f"**Where it loses.** There are {lost[SUBJECT, _NEAR].size} cases of set and level. Near the mirror the "
        f"network is more than 1 dB behind the best of four in {count[SUBJECT, _NEAR]} cases{listed}, and over the "
        f"hemisphere in {count[SUBJECT, _OVER]}. `auto` is that far behind in {count['auto', _NEAR]} cases near the "
        f"mirror and in {count['auto', _OVER]} over the hemisphere. From far away the network's FLIP is below the FLIP "
        f"of every closed form in {int(far.sum())} of {far.size} sets. Levels that are sharp enough for still pictures "
        "flicker more at the near scale. Over the hemisphere the network's pixels change "
        f"{flicker[SUBJECT]:.1f} times as much as they should there, the pixels of `vmf (gaussian)` "
        f"{flicker['vmf (gaussian)']:.2f} times, and the pixels of `{LINEAR}` {flicker[LINEAR]:.1f} times."
    )


def _left(results: Results) -> str:
    side = results.files[0]["crop"]
    top = [results.gains(OPTIMUM, pairs, FOUR).mean() for pairs in PAIR_SETS]
    refine = next(name for name, each in results.methods.items() if each["method"] == "refine")
    closed = {name: [closed_gap(results, name, pairs) for pairs in PAIR_SETS] for name in (SUBJECT, refine)}
    beyond = (
        " A share above 100 % means that the optimum is not quite one: it was found with other pairs than the table "
        "is measured with."
        if max(closed[refine]) > 1
        else ""
    )
    return (
        f"**How much is left.** On the middle {side} x {side} texels of each set, every texel was optimised until "
        f"nothing improved. This optimum is {top[0]:.1f} dB above the best of four near the mirror and {top[1]:.1f} dB "
        f"over the hemisphere. Of this gap the network closes {closed[SUBJECT][0]:.0%} and {closed[SUBJECT][1]:.0%}, "
        f"and `{refine}` closes {closed[refine][0]:.0%} and {closed[refine][1]:.0%}.{beyond}"
    )


def _directional(results: Results) -> str:
    _, plain, rich = next(each for each in targets(results) if each[0] == SUBJECT)
    gains = {
        pairs: np.stack([results.curve[rich, pairs, lod] - results.curve[plain, pairs, lod] for lod in results.lods], 1)
        for pairs in PAIR_SETS
    }
    near = gains[_NEAR].mean(1)
    return (
        f"**Two widths.** `--target gltf-anisotropic` stores two widths for each lobe. On {len(results.sets)} sets "
        "whose bumps run in one direction it changes the network's SNR by "
        f"{gains[_NEAR].mean():+.1f} dB near the mirror and {gains[_OVER].mean():+.1f} dB over the hemisphere in the "
        f"mean. From set to set the change near the mirror goes from {near.min():+.1f} to {near.max():+.1f} dB."
    )


def _ahead(results: Results, name: str) -> int:
    """At how many levels and pair sets the mean is above the mean of every closed form."""
    return sum(
        results.curve[name, pairs, lod].mean() > max(results.curve[f, pairs, lod].mean() for f in results.closed_forms)
        for pairs in PAIR_SETS
        for lod in results.lods
    )
