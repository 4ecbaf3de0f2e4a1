"""What films shall show, beside what they show: lines of the step of this project that is about moving pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from records.films import (
    AUTO,
    LINEAR,
    NEURAL,
    SPARKLE_MORE,
    STEADY,
    SUBJECTS,
    Film,
    gain,
    mean_jod,
    moving,
    ranked,
    share,
)

LEAST_BEHIND = 0.03
"""JOD that auto may be behind LINEAR in a film."""

LOW = 9.5
"""JOD of LINEAR below which a film has something to win."""

LOW_GAIN = 0.5
"""JOD that auto shall win there, in the mean."""

FORM_BEHIND, FORM_SHARE = 0.1, 0.95
"""JOD that auto may be behind a film's best closed form, and in which share of films at least it shall be no more."""

NEURAL_SHARE, NEURAL_BEHIND = 0.85, 0.15
"""Share of films where the network shall be above LINEAR, and JOD that it may be behind in a film."""

STEADY_SHARE = 0.9
"""Share of films that shall flicker as the reference does, and that shall not sparkle."""


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
    """Of films that were not accumulated; the order of films is looked at in both kinds."""
    return [*_auto(found), *_neural(found), *_calm(found), _order([*found, *accumulated])]


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
    rows = [_nowhere_behind(found, AUTO, LEAST_BEHIND)]
    some = low(found)
    if some:
        won = gain(some, AUTO).mean
        name = f"{AUTO}: {LOW_GAIN:g} JOD above {LINEAR}, in the mean of films where {LINEAR} is below {LOW:g}"
        rows.append(Aim(name, f"{won:+.2f} JOD in {len(some)} films", _rounded(won) >= LOW_GAIN))
    near = near_the_best_form(found, AUTO)
    name = f"{AUTO}: at most {FORM_BEHIND:g} JOD behind the best closed form of a film, in {FORM_SHARE:.0%} of films"
    return [*rows, Aim(name, f"{near:.0%}", near >= FORM_SHARE)]


def _neural(found: Sequence[Film]) -> list[Aim]:
    above = gain(found, NEURAL).above
    means = {name: mean_jod(found, name) for name in found[0].forms}
    best = max(means, key=lambda name: means[name])
    mine = mean_jod(found, NEURAL)
    return [
        Aim(f"{NEURAL}: above {LINEAR} in {NEURAL_SHARE:.0%} of films", f"{above:.0%}", above >= NEURAL_SHARE),
        _nowhere_behind(found, NEURAL, NEURAL_BEHIND),
        Aim(
            f"{NEURAL}: mean JOD above the mean of every closed form",
            f"{mine:.2f}, and {means[best]:.2f} for {best}",
            mine > means[best],
        ),
    ]


def _nowhere_behind(found: Sequence[Film], method: str, by: float) -> Aim:
    missed, worst = behind(found, method, by), min(film.over(method) for film in found)
    name = f"{method}: in no film more than {by:g} JOD behind {LINEAR}"
    return Aim(name, f"{len(missed)} of {len(found)} films are, at worst {worst:+.2f} JOD", not missed)


def _calm(found: Sequence[Film]) -> list[Aim]:
    rows = []
    for method in SUBJECTS:
        calm = share(moving(found, method), lambda film, method=method: film.is_steady(method))  # type: ignore[misc]
        clean = share(found, lambda film, method=method: not film.sparkles(method))  # type: ignore[misc]
        least, most = STEADY
        for name, reached in (
            (f"flicker {least:g} to {most:g} times the reference's", calm),
            (f"false sparkle at most {SPARKLE_MORE:g} times the false sparkle of {LINEAR}", clean),
        ):
            aim = f"{method}: {name}, in {STEADY_SHARE:.0%} of films"
            rows.append(Aim(aim, f"{reached:.0%}", reached >= STEADY_SHARE))
    return rows


def _order(found: Sequence[Film]) -> Aim:
    each = ranked(found, "visible", False)
    name = f"visible: rank correlation with JOD at least {RANK:g} over all films and methods"
    return Aim(name, f"{each.overall:.3f}", each.overall >= RANK)


def _rounded(jod: float) -> float:
    """Differences of figures that have few digits, without what floats add."""
    return round(jod, 6)
