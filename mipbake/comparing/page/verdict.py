"""The verdict: how the subject looks beside plain MIP maps, in the words of `mipbake.stack.verdict`; and its details:
what films show method by method, and where the subject is ahead or behind in decibels.

In films ColorVideoVDP decides where it judged, and FLIP where it did not; without films the FLIP of renders. A film or
a render counts at the distance of its median level of detail. A difference in decibels counts where its confidence
interval does not hold 0. `snr-gain` is that difference, with an interval over the same light-view pairs; where it was
not measured, two figures differ if their own intervals do not overlap, which is a far stricter test, because what all
methods find hard is in every figure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

from mipbake.comparing.films import FILM
from mipbake.comparing.page.markup import listed
from mipbake.comparing.result import LINEAR, OPTIMUM, Comparison
from mipbake.quality.figures import SCALES, SNR_GAIN
from mipbake.quality.metrics import MEASURES, PAIR_SETS
from mipbake.stack.verdict import PLAIN_OPTIONS, Distance, Effect, distance_of, in_words
from mipbake.stack.written import SPOKEN

VISIBLE_JOD = 0.1
"""A smaller difference in JOD is none that is visible. A guess: 53 in 100 people would prefer the better film."""

VISIBLE_FLIP = 0.05
"""A smaller difference in FLIP, as a share of the greater FLIP, is none that is visible."""

_JUDGES = ("jod-37", "flip")  # of films: the first of them that was measured decides
_LEAST_DECIBELS = 0.05  # less rounds to 0.0


@dataclass(frozen=True)
class Difference:
    """How far the subject is ahead of a method, in a film or at one scale of one pair set.

    Args:
        measure, view, scale: as in `Figure`.
        rival: the method.
        own, other: figures of the subject and of the method.
        gain: how much better the subject is, in units of the measure; negative where it is worse.
        outcome: 1 better, -1 worse, 0 no difference.
    """

    measure: str
    view: str
    scale: str
    rival: str
    own: float
    other: float
    gain: float
    outcome: int


@dataclass(frozen=True)
class Verdict:
    """The verdict.

    Args:
        sentence: how the subject looks beside plain MIP maps and what to do, without figures and names of methods.
        details: what films show method by method, and decibels.
        paired: whether all intervals are of differences over the same pairs.
    """

    sentence: str
    details: str
    paired: bool


def verdict(comparison: Comparison) -> Verdict:
    """What the figures of a comparison say."""
    subject, found = comparison.subject, comparison.figures
    measured = {(f.view, f.scale) for f in found if f.measure == "snr" and f.method == subject}
    places = [("snr", view, scale) for view in PAIR_SETS for scale in SCALES if (view, scale) in measured]
    best, linear = _against(comparison, places)
    names = {d.rival for d in best}
    against = f"{next(iter(names))}, the best closed form," if len(names) == 1 else "the best closed form of each scale"
    if len(comparison.closed_forms) == 1:  # to be the best of one is not praise
        against = comparison.closed_forms[0]
    clauses: list[str] = []
    for name, differences in ((against, best), (LINEAR, linear if names != {LINEAR} else ())):
        if differences:
            clauses.append(f"{'it' if clauses else subject} {_in_decibels(name, differences)}")
    looks = _in_films(subject, *_against(comparison, _judged(comparison)))
    lead = f"{looks} In decibels of SNR under single lights, " if looks else ""
    details = f"{lead}{'; '.join(clauses)}." if clauses else looks or _alone(comparison)
    details = details or f"Nothing was measured that {subject} could be compared by."
    return Verdict(_for_artists(comparison), details, any(f.measure == SNR_GAIN for f in found))


# ---- in words


def _for_artists(comparison: Comparison) -> str:
    """How the subject looks beside plain MIP maps, distance by distance, and what to do."""
    if comparison.subject == LINEAR:
        return "These are plain MIP maps, which others are compared with."
    found = effects(comparison, comparison.subject)
    if not found:
        return f"How this looks beside plain MIP maps ({PLAIN_OPTIONS}) was not measured."
    return str(in_words(found, _better(comparison)))


def effects(comparison: Comparison, method: str) -> dict[Distance, Effect]:
    """How a method looks beside plain MIP maps at each distance that films show, or renders where there is no film."""
    by_distance: dict[Distance, list[Difference]] = {}
    renders = [("flip", each.scene.view, each.scene.scale) for each in comparison.rendered]
    for place in _judged(comparison) or renders:
        found, figure = difference(comparison, LINEAR, *place, method), comparison.find(LINEAR, *place)
        if found is not None and figure is not None and not math.isnan(figure.lod):
            by_distance.setdefault(distance_of(figure.lod), []).append(found)
    return {distance: _effect(some) for distance, some in by_distance.items()}


def _effect(found: Sequence[Difference]) -> Effect:
    """Of all films, or renders, of a distance together."""
    gain = fmean(each.gain for each in found)
    least = visible(found[0].measure, *(fmean(getattr(each, name) for each in found) for name in ("own", "other")))
    return 0 if abs(gain) < least else 1 if gain > 0 else -1


def _better(comparison: Comparison) -> str:
    """Options of the method that looks better than plain MIP maps somewhere and worse nowhere; "" where none does."""
    for method in comparison.methods:
        found = set(effects(comparison, method.name).values())
        if method.name not in (comparison.subject, LINEAR, OPTIMUM) and 1 in found and -1 not in found:
            return f"--method {method.method} --filter {method.kernel}"
    return ""


def difference(
    comparison: Comparison, rival: str, measure: str, view: str, scale: str, method: str = ""
) -> Difference | None:
    """How far a method, by default the subject, is ahead of another; None where one of them was not measured."""
    own, other = (comparison.find(name, measure, view, scale) for name in (method or comparison.subject, rival))
    if own is None or other is None or math.isnan(own.value - other.value):
        return None
    gain = own.value - other.value if MEASURES[measure].direction == "higher" else other.value - own.value
    if measure == "snr":
        paired, least = comparison.find(rival, SNR_GAIN, view, scale), _LEAST_DECIBELS
        if paired is not None and not math.isnan(paired.value + paired.low + paired.high):
            gain, differ = paired.value, paired.low > 0 or paired.high < 0
        else:
            differ = not (own.low <= other.high and other.low <= own.high)  # true also where there is no interval
    else:
        least = visible(measure, own.value, other.value)
        differ = gain != 0
    outcome = int(math.copysign(1, gain)) if differ and abs(gain) >= least else 0
    return Difference(measure, view, scale, rival, own.value, other.value, gain, outcome)


def visible(measure: str, own: float, other: float) -> float:
    """The least difference of two figures that is visible."""
    return VISIBLE_FLIP * max(own, other) if measure == "flip" else VISIBLE_JOD


def _against(
    comparison: Comparison, places: Sequence[tuple[str, str, str]]
) -> tuple[tuple[Difference, ...], tuple[Difference, ...]]:
    """The subject at each measure, view and scale against the best closed form there, and against `linear (box)`."""
    closed, linear = [], []
    for place in places:
        found = [d for name in comparison.closed_forms if (d := difference(comparison, name, *place))]
        closed += [min(found, key=lambda d: d.gain)] if found else []
        linear += [difference(comparison, LINEAR, *place)] if comparison.subject != LINEAR else []
    return tuple(closed), tuple(d for d in linear if d)


def _in_decibels(rival: str, found: Sequence[Difference]) -> str:
    """What a sentence says of differences to one rival: `beats linear (box) near the mirror at every scale (...)`."""
    parts: list[str] = []
    for outcome, verb in ((1, "beats"), (-1, "loses to")):
        places = [_places(found, view, outcome) for view in dict.fromkeys(d.view for d in found)]
        if any(places):
            parts.append(f"{verb} {'it' if parts else rival} {listed(place for place in places if place)}")
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
    return f"{SPOKEN[view]} {where} (by {low if low == high else f'{low} to {high}'} dB)"


# ---- films


def film_named(view: str) -> str:
    """`the floor`: what a sentence calls the film with the view `film-floor`."""
    return f"the {view.removeprefix(FILM).replace('-', ' ')}"


def _judged(comparison: Comparison) -> list[tuple[str, str, str]]:
    """The measure that decides in films, and the view and scale of every film; empty where none was measured."""
    films = list(dict.fromkeys(f.view for f in comparison.figures if f.view.startswith(FILM)))
    found = {figure.measure for figure in comparison.figures if figure.view in films}
    return [(measure, film, "") for measure in [each for each in _JUDGES if each in found][:1] for film in films]


def _in_films(subject: str, closed: Sequence[Difference], linear: Sequence[Difference]) -> str:
    """What films show, for people; empty where there is no film."""
    names = {d.rival for d in closed}
    best = f"{next(iter(names))}, the best closed form of every film," if len(names) == 1 else ""
    groups = [(LINEAR, linear), (best or "the best closed form of each film", closed if names != {LINEAR} else ())]
    clauses = [_looks(name, found) for name, found in groups if found]
    if not clauses:
        return ""
    judge = "FLIP" if (*closed, *linear)[0].measure == "flip" else "ColorVideoVDP"
    return f"In films, as {judge} judges them, {subject} {'; it '.join(clauses)}."


def _looks(rival: str, found: Sequence[Difference]) -> str:
    """`looks better than linear (box) on the floor (by 0.42 JOD) and shows no visible difference on the wall`."""
    parts: list[str] = []
    for outcome, word in ((1, "better"), (-1, "worse")):
        places = [f"on {film_named(d.view)} ({_by(d)})" for d in found if d.outcome == outcome]
        if places:
            parts.append(f"looks {word} than {'it' if parts else rival} {listed(places)}")
    same = [film_named(d.view) for d in found if d.outcome == 0]
    if same:
        where = f"on {listed(same)}" if parts or len(found) == 1 else "in any film"
        parts.append(f"shows no visible difference{'' if parts else f' from {rival}'} {where}")
    return listed(parts)


def _by(found: Difference) -> str:
    if found.measure == "flip":
        return f"{found.own:.3f} instead of {found.other:.3f}"
    return f"by {abs(found.gain):.2f} JOD"


def _alone(comparison: Comparison) -> str:
    """What films say of a subject without a closed form beside it; empty where there is one, or no film."""
    places = _judged(comparison) if not comparison.closed_forms else []
    judge, best, digits = ("FLIP", 0, 3) if places and places[0][0] == "flip" else ("JOD of ColorVideoVDP", 10, 2)
    found = [(view, comparison.find(comparison.subject, measure, view, "")) for measure, view, _ in places]
    figures = [f"{f.value:.{digits}f} on {film_named(view)}" for view, f in found if f and not math.isnan(f.value)]
    if not figures:
        return ""
    return (
        f"{comparison.subject} was compared with no closed form. Its films have {listed(figures)}, in {judge}: {best} "
        "is no visible difference from the reference."
    )


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
