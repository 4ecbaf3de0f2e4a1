"""Who is ahead: networks and blends against closed forms, what was aimed at, and the limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mipbake.quality.figures import SCALES
from mipbake.quality.metrics import MEASURES, PAIR_SETS, mean_interval
from results_page.files import FOUR, LINEAR, OPTIMUM, SUBJECT, Results
from results_page.tables import DIGITS, PLACES, average, lod_heads, loss, table

STEADY = (0.85, 1.15)  # flicker that is as much as it should be
SHIMMERS = 1.5  # flicker of `linear (box)` from which a set counts
IN_MOTION = ("near", "1:1")

_LEAST_GAP = 0.3  # dB between the best of four and the optimum from which a share of it means something


def outcome(results: Results, measure: str, view: str, scale: str) -> list[str] | None:
    """Subject against the closed form with the best mean: which, both means, the difference with its interval."""
    if (SUBJECT, measure, view, scale) not in results.figures:
        return None
    rivals = [name for name in results.closed_forms if (name, measure, view, scale) in results.figures]
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
        for view in (*PAIR_SETS, "sphere"):
            for scale in SCALES:
                row = outcome(results, measure, view, scale)
                if row:
                    rows[f"{MEASURES[measure].title}, {PLACES.get(view, view)}, {scale}"] = row
    heads = [SUBJECT, "best closed form", "difference, better positive", "sets where neural is better", "ahead"]
    return table("measure, view, scale", heads, rows)


def against_four(results: Results, pairs: str) -> str:
    """Measured methods against the best of FOUR for every set and level: mean gains, the worst, how many lose."""
    rows = {}
    for name in results.learned:
        gains = results.gains(name, pairs, FOUR)
        at, lod = np.unravel_index(gains.argmin(), gains.shape)
        rows[name] = [
            *(f"{gain:+.1f}" for gain in gains.mean(0)),
            f"{gains.mean():+.2f}",
            f"{gains.min():+.1f} ({results.sets[int(at)]}, {results.lods[int(lod)]:g})",
            f"{int((gains < -1).sum())}, {int((gains < -0.25).sum())} of {gains.size}",
        ]
    heads = [*lod_heads(results), "mean", "worst (set, lod)", "below -1 dB, below -0.25 dB"]
    return table(pairs, heads, rows)


def won(results: Results, name: str) -> dict[str, np.ndarray]:
    """Scale to whether the FLIP of each set's sphere is below the FLIP of every closed form."""
    scales = [scale for scale in SCALES if (name, "flip", "sphere", scale) in results.figures]
    least = {s: np.min([results.figures[f, "flip", "sphere", s] for f in results.closed_forms], 0) for s in scales}
    return {scale: results.figures[name, "flip", "sphere", scale] < least[scale] for scale in scales}


def pictures_won(results: Results) -> str:
    """In how many pictures of spheres, of a set at a scale, FLIP is below the FLIP of every closed form."""
    found = {name: won(results, name) for name in results.learned}
    rows = {
        name: [*(f"{int(w.sum())} of {w.size}" for w in of_name.values()), f"{np.mean([*of_name.values()]):.0%}"]
        for name, of_name in found.items()
        if of_name
    }
    return table("FLIP below every closed form", [*SCALES, "all"], rows)


def _steady(results: Results, name: str, pairs: str, scale: str) -> np.ndarray:
    """Flicker of the sets where `linear (box)` shimmers."""
    shimmers = results.figures[LINEAR, "flicker", pairs, scale] > SHIMMERS
    return results.figures[name, "flicker", pairs, scale][shimmers]


def flicker(results: Results) -> str:
    """How many sets are steady of those where `linear (box)` shimmers, and from where to where flicker goes there."""
    rows = {}
    for name in results.methods:
        rows[name] = []
        for pairs in PAIR_SETS:
            for scale in IN_MOTION:
                found = _steady(results, name, pairs, scale)
                inside = int(((found >= STEADY[0]) & (found <= STEADY[1])).sum())
                extent = f" ({found.min():.2f} to {found.max():.2f})" if len(found) else ""
                rows[name].append(f"{inside} of {len(found)}{extent}")
    return table("", [f"{PLACES[pairs]}, {scale}" for pairs in PAIR_SETS for scale in IN_MOTION], rows)


@dataclass(frozen=True)
class Aim:
    """Something that was aimed at: what, the figure, and whether it was met."""

    what: str
    found: str
    met: bool


def aims(whole: Results, crop: Results | None, directional_gain: float | None) -> str:
    """What was aimed at, with what was measured."""
    every = [*_aims(whole, crop)]
    if directional_gain is not None:
        found = f"{directional_gain:+.2f} dB"
        what = "anisotropic target near the mirror at least 1 dB over the isotropic one, the best method of each"
        every.append(Aim(what, found, directional_gain >= 1))
    return table("aim", ["measured", "met"], {each.what: [each.found, "yes" if each.met else "no"] for each in every})


def _aims(whole: Results, crop: Results | None) -> Iterator[Aim]:
    limits = {"neural": (1.5, 0.0, 1.0), "auto": (2.0, None, 0.25)}
    for name, (mirror, hemisphere, below) in limits.items():
        if name not in whole.learned:
            continue
        near, over = (whole.gains(name, pairs, FOUR) for pairs in PAIR_SETS)
        yield Aim(
            f"{name}: near the mirror at least {mirror:g} dB above the best of four",
            f"{near.mean():+.2f} dB",
            near.mean() >= mirror,
        )
        if hemisphere is not None:
            yield Aim(
                f"{name}: over the hemisphere not below the best of four", f"{over.mean():+.2f} dB", over.mean() >= 0
            )
        every = np.concatenate([near, over], 1)
        lost = int((every < -below).sum())
        yield Aim(
            f"{name}: nowhere more than {below:g} dB below the best of four",
            f"{lost} of {every.size} below, at worst {every.min():+.2f} dB",
            lost == 0,
        )
    yield from _seen(whole)
    if crop and OPTIMUM in crop.methods:
        for name in (name for name in crop.learned if crop.methods[name]["method"] == "refine"):
            for pairs in PAIR_SETS:
                gap = closed_gap(crop, name, pairs)
                what = f"{name}: at least 90 % of the gap to the optimum, {PLACES[pairs]}"
                yield Aim(what, _share(gap) or "the optimum is not ahead", gap >= 0.9)


def _seen(whole: Results) -> Iterator[Aim]:
    """Aims in pictures and in motion."""
    shares = [*won(whole, SUBJECT).values()] if SUBJECT in whole.learned else []
    if shares:
        share = float(np.mean(shares))
        yield Aim(f"{SUBJECT}: FLIP below every closed form in 85 % of pictures", f"{share:.0%}", share >= 0.85)
    for name in (name for name in ("neural", "auto") if name in whole.learned):
        found = np.concatenate([_steady(whole, name, pairs, scale) for pairs in PAIR_SETS for scale in IN_MOTION])
        inside = int(((found >= STEADY[0]) & (found <= STEADY[1])).sum())
        yield Aim(
            f"{name}: flicker between {STEADY[0]} and {STEADY[1]} at lod 0 to 1 where {LINEAR} is above {SHIMMERS}",
            f"{inside} of {len(found)}",
            inside == len(found),
        )


def closed_gap(results: Results, name: str, pairs: str, rivals: Sequence[str] = FOUR) -> float:
    """(method - best of four) / (optimum - best of four) of the means over sets and levels."""
    own, top = (results.gains(each, pairs, rivals).mean() for each in (name, OPTIMUM))
    return float(own / top) if top > _LEAST_GAP else float("nan")


def _share(gap: float) -> str:
    """Of a gap; empty where there is none."""
    return f"{gap:.0%}" if math.isfinite(gap) else ""


def gaps(results: Results) -> str:
    """Closed gap by pair set and lod: (method - best) / (optimum - best) of the means over sets."""
    rows = {}
    for pairs in PAIR_SETS:
        top = results.gains(OPTIMUM, pairs, FOUR).mean(0)
        rows[f"{pairs}: optimum over the best of four"] = [f"{gain:+.1f} dB" for gain in top] + [
            f"{top.mean():+.1f} dB"
        ]
        for name in results.learned:
            own = results.gains(name, pairs, FOUR).mean(0)
            cells = [_share(o / t) if t > _LEAST_GAP else "" for o, t in zip(own, top, strict=True)]
            rows[f"{pairs}: closed gap, {name}"] = [*cells, _share(closed_gap(results, name, pairs))]
    return table("", [*lod_heads(results), "mean"], rows)


def shortfall(results: Results) -> str:
    """A sentence on where the optimum is behind the oracle: there it is not a limit."""
    behind = np.concatenate([results.gains(OPTIMUM, pairs).ravel() for pairs in PAIR_SETS])
    lost = behind[behind < -0.25]
    if not len(lost):
        return (
            f"In none of the {behind.size} cases of set, level and pair set the optimum is more than 0.25 dB behind "
            "the best closed form."
        )
    return (
        f"In {len(lost)} of the {behind.size} cases of set, level and pair set the optimum is more than 0.25 dB behind "
        f"the best closed form, by {-behind.min():.1f} dB at worst. It is no limit there."
    )
