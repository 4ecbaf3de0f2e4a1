"""What films show: in which the subject looks better than a method, in which worse, in which no different.

ColorVideoVDP decides where it judged, and FLIP where it did not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mipbake.comparing.page.markup import listed
from mipbake.comparing.ranking import LINEAR, closed_forms
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import Figure
from mipbake.quality.metrics import MEASURES

VISIBLE_JOD = 0.1
"""A smaller difference in JOD is none that is visible. A guess: 53 in 100 people would prefer the better film."""

VISIBLE_FLIP = 0.05
"""A smaller difference in FLIP, as a share of the greater FLIP, is none that is visible."""

_JUDGES = ("jod-37", "flip")  # the first of them that was measured decides


@dataclass(frozen=True)
class Seen:
    """How the subject looks beside a method in one film.

    Args:
        film: the view of its figures, `film-floor`.
        rival: the method.
        measure: that decided, a name in MEASURES.
        own, other: its figures, of the subject and of the method.
        outcome: 1 better, -1 worse, 0 no visible difference.
    """

    film: str
    rival: str
    measure: str
    own: float
    other: float
    outcome: int

    @property
    def gain(self) -> float:
        """How much better the subject's figure is, in units of the measure; negative where it is worse."""
        return self.own - self.other if MEASURES[self.measure].direction == "higher" else self.other - self.own


def seen(comparison: Comparison) -> tuple[tuple[Seen, ...], tuple[Seen, ...]]:
    """The subject in every film against the best closed form of the film, and against `linear (box)`."""
    films, measure = _judged(comparison)
    if measure is None:
        return (), ()
    rivals = closed_forms(comparison)
    closed = [_best(comparison, measure, film, rivals) for film in films]
    linear = [_beside(comparison, measure, film, LINEAR) for film in films] if comparison.subject != LINEAR else []
    return tuple(each for each in closed if each), tuple(each for each in linear if each)


def seen_sentence(subject: str, closed: Sequence[Seen], linear: Sequence[Seen]) -> str:
    """What `seen` found, for people; empty where there is no film."""
    names = {each.rival for each in closed}
    best = f"{next(iter(names))}, the best closed form of every film," if len(names) == 1 else ""
    groups = [(LINEAR, linear), (best or "the best closed form of each film", closed if names != {LINEAR} else [])]
    clauses = [_outcome(name, found) for name, found in groups if found]
    if not clauses:
        return ""
    judge = "ColorVideoVDP" if (*closed, *linear)[0].measure != "flip" else "FLIP"
    return f"In films, as {judge} judges them, {subject} {'; it '.join(clauses)}."


def alone_sentence(comparison: Comparison) -> str:
    """What films say of a subject without a closed form beside it; empty where there is one, or no film."""
    films, measure = _judged(comparison)
    if measure is None or closed_forms(comparison):
        return ""
    found = [(film, each.value) for film in films if (each := _figure(comparison, comparison.subject, measure, film))]
    judge, best, digits = ("JOD of ColorVideoVDP", 10, 2) if measure != "flip" else ("FLIP", 0, 3)
    figures = listed(f"{value:.{digits}f} on {spoken(film)}" for film, value in found if not math.isnan(value))
    if not figures:
        return ""
    return (
        f"{comparison.subject} was compared with no closed form. Its films have {figures}, in {judge}: {best} is no "
        "visible difference from the reference."
    )


def spoken(film: str) -> str:
    """`the floor`: what a sentence calls the film with the view `film-floor`."""
    return f"the {film.removeprefix('film-').replace('-', ' ')}"


def _judged(comparison: Comparison) -> tuple[list[str], str | None]:
    """The films, and the measure that decides in them; None where none was measured."""
    films = list(dict.fromkeys(f.view for f in comparison.figures if f.view.startswith("film-")))
    found = {figure.measure for figure in comparison.figures if figure.view in films}
    return films, next((measure for measure in _JUDGES if measure in found), None)


def _best(comparison: Comparison, measure: str, film: str, rivals: Sequence[str]) -> Seen | None:
    found = [each for name in rivals if (each := _beside(comparison, measure, film, name))]
    return min(found, key=lambda each: each.gain, default=None)


def _beside(comparison: Comparison, measure: str, film: str, rival: str) -> Seen | None:
    own, other = (_figure(comparison, name, measure, film) for name in (comparison.subject, rival))
    if own is None or other is None or math.isnan(own.value - other.value):
        return None
    apart = own.value - other.value if MEASURES[measure].direction == "higher" else other.value - own.value
    least = VISIBLE_FLIP * max(own.value, other.value) if measure == "flip" else VISIBLE_JOD
    outcome = 0 if abs(apart) < least or apart == 0 else int(math.copysign(1, apart))
    return Seen(film, rival, measure, own.value, other.value, outcome)


def _figure(comparison: Comparison, method: str, measure: str, film: str) -> Figure | None:
    try:
        return comparison.figure(method, measure, film, "")
    except KeyError:
        return None


def _outcome(rival: str, found: Sequence[Seen]) -> str:
    """`looks better than linear (box) on the floor (by 0.42 JOD) and shows no visible difference on the wall`."""
    named, parts = False, []
    for outcome, word in ((1, "better"), (-1, "worse")):
        places = [f"on {spoken(each.film)} ({_by(each)})" for each in found if each.outcome == outcome]
        if places:
            parts.append(f"looks {word} than {'it' if named else rival} {listed(places)}")
            named = True
    same = [each for each in found if each.outcome == 0]
    if same:
        where = f"on {listed(spoken(each.film) for each in same)}" if parts or len(found) == 1 else "in any film"
        parts.append(f"shows no visible difference{'' if named else f' from {rival}'} {where}")
    return listed(parts)


def _by(found: Seen) -> str:
    if found.measure == "flip":
        return f"{found.own:.3f} instead of {found.other:.3f}"
    return f"by {abs(found.gain):.2f} JOD"
