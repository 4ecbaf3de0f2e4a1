"""The verdict: what films show of the subject, then where it is ahead, where behind, and where no difference shows, in
decibels of SNR.

A difference in decibels counts where its confidence interval does not hold 0. `snr-gain` is that difference, with an
interval over the same light-view pairs; where it was not measured, two figures differ if their own intervals do not
overlap, which is a far stricter test, because what all methods find hard is in every figure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mipbake.comparing.page.markup import listed
from mipbake.comparing.page.seen import Seen, alone_sentence, seen, seen_sentence
from mipbake.comparing.ranking import LINEAR, OPTIMUM, closed_forms
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import SCALES, SNR_GAIN, Figure
from mipbake.quality.metrics import PAIR_SETS

PLACES = {"near-mirror": "near the mirror", "hemisphere": "over the hemisphere"}
"""Pair sets as sentences call them."""

_VISIBLE = 0.05  # dB: less rounds to 0.0


@dataclass(frozen=True)
class Difference:
    """How far the subject is ahead of a method, at one scale of one pair set.

    Args:
        view, scale: as in `Figure`.
        rival: the method.
        gain: in dB, positive where the subject is ahead; low, high: its 95 % interval, nan where it has none.
        outcome: 1 ahead, -1 behind, 0 no difference.
    """

    view: str
    scale: str
    rival: str
    gain: float
    low: float
    high: float
    outcome: int


@dataclass(frozen=True)
class Verdict:
    """The verdict.

    Args:
        sentence: for people.
        closed: against the best closed form of each scale and pair set; linear: against `linear (box)`.
        gap: view and scale to the share of the way from the best closed form to the optimum that the subject goes.
        paired: whether all intervals are of differences over the same pairs.
        seen_closed: against the best closed form of each film; seen_linear: against `linear (box)` in each film.
    """

    sentence: str
    closed: tuple[Difference, ...]
    linear: tuple[Difference, ...]
    gap: dict[tuple[str, str], float]
    paired: bool
    seen_closed: tuple[Seen, ...] = ()
    seen_linear: tuple[Seen, ...] = ()


def verdict(comparison: Comparison) -> Verdict:
    """What the figures of a comparison say."""
    subject = comparison.subject
    rivals = closed_forms(comparison)
    best = [d for key in _measured(comparison) if (d := _best(comparison, rivals, *key))]
    linear = [d for key in _measured(comparison) if subject != LINEAR and (d := difference(comparison, LINEAR, *key))]
    gap = {(d.view, d.scale): share for d in best if (share := _closed_gap(comparison, d)) is not None}
    names = {d.rival for d in best}
    against = f"{next(iter(names))}, the best closed form," if len(names) == 1 else "the best closed form of each scale"
    if len(rivals) == 1:  # to be the best of one is not praise
        against = rivals[0]
    clauses: list[str] = []
    for name, found in ((against, best), (LINEAR, linear if names != {LINEAR} else [])):
        if found:
            clauses.append(f"{'it' if clauses else subject} {_outcome(name, found)}")
    films = seen(comparison)
    looks = seen_sentence(subject, *films)
    lead = f"{looks} In decibels of SNR under single lights, " if looks else ""
    sentence = f"{lead}{'; '.join(clauses)}." if clauses else looks
    sentence = sentence or alone_sentence(comparison)
    sentence = sentence or f"Nothing was measured that {subject} could be compared by."
    paired = any(figure.measure == SNR_GAIN for figure in comparison.figures)
    return Verdict(sentence, tuple(best), tuple(linear), gap, paired, *films)


def best_in_renders(comparison: Comparison) -> str:
    """A sentence on which method has the lowest FLIP in which render, the optimum aside; empty without such figures.

    SNR is ruled by highlights, FLIP by what a viewer notices: they need not agree, so the verdict is never alone.
    """
    places: dict[str, dict[str, list[str]]] = {}
    for view, scale in dict.fromkeys((each.scene.view, each.scene.scale) for each in comparison.rendered):
        found = [f for f in comparison.figures if (f.measure, f.view, f.scale) == ("flip", view, scale)]
        found = [f for f in found if not math.isnan(f.value) and f.method != OPTIMUM]
        if found:
            best = min(found, key=lambda f: f.value).method
            places.setdefault(best, {}).setdefault(view, []).append(scale)
    parts = []
    for method, views in places.items():
        where = [f"on the {view}" + (f" at {listed(scales)}" if all(scales) else "") for view, scales in views.items()]
        parts.append(f"with {method} {listed(where)}")
    return f"In renders, FLIP is the lowest {listed(parts)}." if parts else ""


def difference(comparison: Comparison, rival: str, view: str, scale: str) -> Difference | None:
    """How far the subject is ahead of a method; None where one of them was not measured."""
    own, other = (_figure(comparison, name, "snr", view, scale) for name in (comparison.subject, rival))
    if own is None or other is None or math.isnan(own.value - other.value):
        return None
    gain = own.value - other.value
    paired = _figure(comparison, rival, SNR_GAIN, view, scale)
    if paired is not None and not math.isnan(paired.value + paired.low + paired.high):
        gain, low, high = paired.value, paired.low, paired.high
        differ = low > 0 or high < 0
    else:
        low = high = math.nan
        differ = not (own.low <= other.high and other.low <= own.high)  # true also where there is no interval
    outcome = int(math.copysign(1, gain)) if differ and abs(gain) >= _VISIBLE else 0
    return Difference(view, scale, rival, gain, low, high, outcome)


def _measured(comparison: Comparison) -> list[tuple[str, str]]:
    """View and scale of the subject's SNR, in the order of pair sets and scales."""
    found = {(f.view, f.scale) for f in comparison.figures if f.measure == "snr" and f.method == comparison.subject}
    return [(view, scale) for view in PAIR_SETS for scale in SCALES if (view, scale) in found]


def _best(comparison: Comparison, rivals: Iterable[str], view: str, scale: str) -> Difference | None:
    found = [d for name in rivals if (d := difference(comparison, name, view, scale))]
    return min(found, key=lambda d: d.gain, default=None)


def _closed_gap(comparison: Comparison, found: Difference) -> float | None:
    """(SNR - best closed form) / (optimum - best closed form), where the optimum is ahead of the closed form."""
    optimum = _figure(comparison, OPTIMUM, "snr", found.view, found.scale)
    rival = _figure(comparison, found.rival, "snr", found.view, found.scale)
    if optimum is None or rival is None or comparison.subject == OPTIMUM:
        return None
    room = optimum.value - rival.value
    return found.gain / room if room > _VISIBLE else None


def _figure(comparison: Comparison, method: str, measure: str, view: str, scale: str) -> Figure | None:
    try:
        return comparison.figure(method, measure, view, scale)
    except KeyError:
        return None


def _outcome(rival: str, found: Sequence[Difference]) -> str:
    """What a sentence says of differences to one rival: `beats linear (box) near the mirror at every scale (...)`."""
    named, parts = False, []
    for outcome, verb in ((1, "beats"), (-1, "loses to")):
        places = [_places(found, view, outcome) for view in dict.fromkeys(d.view for d in found)]
        if any(places):
            parts.append(f"{verb} {'it' if named else rival} {listed(place for place in places if place)}")
            named = True
    if not parts:
        return f"shows no difference from {rival} at any scale"
    if any(d.outcome == 0 for d in found):
        parts.append("shows no difference elsewhere")
    return listed(parts)


def _places(found: Sequence[Difference], view: str, outcome: int) -> str:
    """`near the mirror at near and 1:1 (by 1.2 to 3.4 dB)`: where in a pair set an outcome is to be seen."""
    here = [d for d in found if d.view == view]
    chosen = [d for d in here if d.outcome == outcome]
    if not chosen:
        return ""
    every = len(chosen) == len(here) and len(here) > 1
    where = "at every scale" if every else f"at {listed(d.scale for d in chosen)}"
    low, high = (f"{f(abs(d.gain) for d in chosen):.1f}" for f in (min, max))
    return f"{PLACES[view]} {where} (by {low if low == high else f'{low} to {high}'} dB)"
