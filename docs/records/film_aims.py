"""What films shall show, beside what they show: lines of the step of this project that is about moving pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from records.films import (
    AUTO,
    LINEAR,
    NEURAL,
    STEADY,
    Film,
    gain,
    mean_jod,
    moving,
    ranked,
    share,
)

LEAST_BEHIND, LEAST_SHARE, MOST_BEHIND = 0.03, 0.97, 0.15
"""JOD that auto may be behind LINEAR in a film, in which share of films at least it shall be no more, and JOD that it
may be behind in any film."""

LOW = 9.5
"""JOD of LINEAR below which a film has something to win."""

LOW_GAIN = 0.5
"""JOD that auto shall win there, in the mean."""

FORM_BEHIND, FORM_SHARE, FORM_GAIN = 0.1, 0.95, 0.35
"""JOD that auto may be behind a film's best closed form, in which share of films at least it shall be no more, and JOD
by which its mean shall be above the mean of any closed form."""

NEURAL_GAIN, NEURAL_BEHIND = 0.4, 0.2
"""JOD that the network shall win where something can be won, and JOD that it may be behind in any film."""

ACCUMULATED_GAIN, ACCUMULATED_BEHIND = 0.4, 0.1
"""The same of auto in films whose frames are accumulated."""

STEADY_SHARE = 0.6
"""Share of films that shall flicker as the reference does."""

RANK = 0.9
"""Rank correlation that the measure which is minimised shall have with JOD."""


@dataclass(frozen=True)
class Aim:
    """An aim and what was reached.

    Args:
        name: what is aimed at. reached: what was measured, for readers. met: whether that is enough.
    """

    name: str
    reached: str
    met: bool


def aims(found: Sequence[Film], accumulated: Sequence[Film]) -> list[Aim]:
    """Of films that were not accumulated, and of each sampler that accumulates; the order is that of all films."""
    rows = [*_auto(found), *_neural(found)]
    for sampler in dict.fromkeys(film.sampler for film in accumulated):
        some = [film for film in accumulated if film.sampler == sampler]
        under = f"{AUTO}, {sampler}"
        rows += [*_wins(some, AUTO, ACCUMULATED_GAIN, under), _nowhere_behind(some, AUTO, ACCUMULATED_BEHIND, under)]
    return [*rows, *_calm(found), _order([*found, *accumulated])]


def low(found: Sequence[Film]) -> list[Film]:
    """Films in which something can be won."""
    return [film for film in found if film.jod(LINEAR) < LOW]


def behind(found: Sequence[Film], method: str, by: float) -> list[Film]:
    """Films in which a method is behind LINEAR by more JOD than that, the farthest first."""
    missed = [film for film in found if _rounded(film.over(method)) < -by]
    return sorted(missed, key=lambda film: film.over(method))


def near_the_best_form(found: Sequence[Film], method: str) -> float:
    """Share of films in which a method is not more than FORM_BEHIND behind the best closed form of the film."""
    return share(found, lambda film: _rounded(film.behind_the_best_form(method)) <= FORM_BEHIND)


def _auto(found: Sequence[Film]) -> list[Aim]:
    kept = 1 - len(behind(found, AUTO, LEAST_BEHIND)) / len(found)
    near = near_the_best_form(found, AUTO)
    means = {name: mean_jod(found, name) for name in found[0].forms}
    best = max(means, key=lambda name: means[name])
    ahead = mean_jod(found, AUTO) - means[best]
    return [
        Aim(
            f"{AUTO}: at most {LEAST_BEHIND:g} JOD behind {LINEAR}, in {LEAST_SHARE:.0%} of films",
            f"{kept:.0%}",
            kept >= LEAST_SHARE,
        ),
        _nowhere_behind(found, AUTO, MOST_BEHIND),
        *_wins(found, AUTO, LOW_GAIN),
        Aim(
            f"{AUTO}: at most {FORM_BEHIND:g} JOD behind the best closed form of a film, in {FORM_SHARE:.0%} of films",
            f"{near:.0%}",
            near >= FORM_SHARE,
        ),
        Aim(
            f"{AUTO}: mean JOD {FORM_GAIN:g} above the mean of every closed form",
            f"{ahead:+.2f} beside {best}",
            _rounded(ahead) >= FORM_GAIN,
        ),
    ]


def _neural(found: Sequence[Film]) -> list[Aim]:
    return [*_wins(found, NEURAL, NEURAL_GAIN), _nowhere_behind(found, NEURAL, NEURAL_BEHIND)]


def _wins(found: Sequence[Film], method: str, least: float, named: str = "") -> list[Aim]:
    """What a method wins where something can be won; no aim where nothing can."""
    some = low(found)
    if not some:
        return []
    won = gain(some, method).mean
    name = f"{named or method}: {least:g} JOD above {LINEAR}, in the mean of films where {LINEAR} is below {LOW:g}"
    return [Aim(name, f"{won:+.2f} JOD in {len(some)} films", _rounded(won) >= least)]


def _nowhere_behind(found: Sequence[Film], method: str, by: float, named: str = "") -> Aim:
    missed, worst = behind(found, method, by), min(film.over(method) for film in found)
    name = f"{named or method}: in no film more than {by:g} JOD behind {LINEAR}"
    return Aim(name, f"{len(missed)} of {len(found)} films are, at worst {worst:+.2f} JOD", not missed)


def _calm(found: Sequence[Film]) -> list[Aim]:
    moved = moving(found, AUTO)
    calm, restless = share(moved, lambda film: film.is_steady(AUTO)), sum(film.is_restless(AUTO) for film in moved)
    least, most = STEADY
    return [
        Aim(
            f"{AUTO}: flicker {least:g} to {most:g} times the reference's, in {STEADY_SHARE:.0%} of films",
            f"{calm:.0%}",
            calm >= STEADY_SHARE,
        ),
        Aim(
            f"{AUTO}: in no film flicker above {most:g} times the reference's and above the flicker of {LINEAR}",
            f"{restless} of {len(moved)} films have",
            not restless,
        ),
    ]


def _order(found: Sequence[Film]) -> Aim:
    each = ranked(found, "visible", False)
    name = f"visible: rank correlation with JOD at least {RANK:g} over all films and methods"
    return Aim(name, f"{each.overall:.3f}", each.overall >= RANK)


def _rounded(jod: float) -> float:
    """Differences of figures that have few digits, without what floats add."""
    return round(jod, 6)
