"""What the record of benchmarks/films.py says: films, and how methods stand in them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

AUTO, NEURAL, LINEAR = "auto", "neural", "linear (box)"
SUBJECTS = (AUTO, NEURAL)
"""What is no closed form, of what is filmed."""

JUDGE = "jod-37"
"""The measure that methods are judged by: ColorVideoVDP at 37 pixels per degree, in JOD."""

STEADY = (0.8, 1.25)
"""Flicker that is within 25 % of the reference: change over the change there should be."""

SPARKLE_MORE = 1.25
"""False sparkle over that of LINEAR which is within 25 %."""

NO_SPARKLE = 1e-4
"""False sparkle that is as good as none: one value in a thousand is a tenth brighter than what is let pass."""

GLOSSY, BUMPY = 0.5, 0.2
"""Mean roughness below which a set counts as glossy, and root mean square of slopes from which it counts as bumpy:
about half of the test sets each."""

APART = 0.1
"""JOD by which two methods differ in a film when their order is asked for."""


@dataclass(frozen=True)
class Film:
    """One film of one set.

    Args:
        set, scene, sampler: names; the scene is `floor`, `low-floor`, `wall` or `sphere`.
        stratum: of the set, such as `glossy, bumpy`.
        converged: whether the reference is as clean as wanted.
        figures: method to measure to figure, without those that are not numbers.
    """

    set: str
    scene: str
    sampler: str
    stratum: str
    converged: bool
    figures: Mapping[str, Mapping[str, float]]

    @property
    def methods(self) -> list[str]:
        """All of them, as they were filmed."""
        return list(self.figures)

    @property
    def forms(self) -> list[str]:
        """The closed forms among them."""
        return [name for name in self.figures if name not in SUBJECTS]

    def jod(self, method: str) -> float:
        """What the judge says."""
        return self.figures[method][JUDGE]

    def over(self, method: str, other: str = LINEAR) -> float:
        """JOD of a method minus JOD of another one."""
        return self.jod(method) - self.jod(other)

    def behind_the_best_form(self, method: str) -> float:
        """JOD that the best closed form of this film is ahead by; below 0 where it is behind."""
        return max(self.jod(name) for name in self.forms) - self.jod(method)

    def is_steady(self, method: str) -> bool:
        """Whether it flickers as the reference does, within STEADY."""
        return STEADY[0] <= self.figures[method]["flicker"] <= STEADY[1]

    def sparkles(self, method: str) -> bool:
        """Whether it sparkles more than LINEAR does, by more than 25 %."""
        found, plain = (self.figures[name]["sparkle"] for name in (method, LINEAR))
        return found > max(SPARKLE_MORE * plain, NO_SPARKLE)


def films(data: Mapping[str, Any], accumulated: bool) -> list[Film]:
    """The films of a record, under samplers that accumulate frames or under the others."""
    return [
        Film(
            name, film["scene"].removeprefix("film-"), film["sampler"], _stratum(each), film["converged"],
            {m: {k: v for k, v in found.items() if v is not None} for m, found in film["figures"].items()},
        )
        for name, each in data["sets"].items()
        for film in each["films"]
        if film["sampler"].startswith("accumulated") == accumulated
    ]  # fmt: skip


def _stratum(measured: Mapping[str, Any]) -> str:
    gloss = "glossy" if measured["roughness"] < GLOSSY else "matte"
    return f"{gloss}, {'bumpy' if measured['slope'] >= BUMPY else 'flat'}"


@dataclass(frozen=True)
class Gain:
    """How a method stands beside another one.

    Args:
        mean: difference in JOD. worst, best: the films where it is least and most. above: share where it is above 0.
        film_gain: difference in a film.
    """

    mean: float
    worst: Film
    best: Film
    above: float
    film_gain: Callable[[Film], float]


def gain(found: Sequence[Film], method: str, other: str = LINEAR) -> Gain:
    """Of one film or more."""

    def each(film: Film) -> float:
        return film.over(method, other)

    above = share(found, lambda film: each(film) > 0)
    return Gain(fmean(map(each, found)), min(found, key=each), max(found, key=each), above, each)


def mean_jod(found: Sequence[Film], method: str) -> float:
    """Of one film or more; nan of none."""
    return fmean(film.jod(method) for film in found) if found else math.nan


def share(found: Sequence[Film], holds: Callable[[Film], bool]) -> float:
    """Of films; nan of none."""
    return fmean(holds(film) for film in found) if found else math.nan


def moving(found: Sequence[Film], method: str) -> list[Film]:
    """Films whose reference changes enough that flicker is a number."""
    return [film for film in found if "flicker" in film.figures[method]]


@dataclass(frozen=True)
class Ranked:
    """How a measure ranks beside the judge.

    Args:
        triples: of set, film and method. overall: Spearman's rank correlation over all of them.
        within: mean of the rank correlations within films.
        pairs: of methods in a film that differ by APART or more. right: share of them that are in the right order.
    """

    triples: int
    overall: float
    within: float
    pairs: int
    right: float


def ranked(found: Sequence[Film], measure: str, higher: bool) -> Ranked:
    """Ranks by a measure, of which more is better, or less."""
    sign = 1.0 if higher else -1.0
    films_values = [
        [(each[JUDGE], sign * each[measure]) for each in film.figures.values() if measure in each] for film in found
    ]
    everything = list(itertools.chain.from_iterable(films_values))
    within = [value for value in map(spearman, films_values) if not math.isnan(value)]
    pairs = [
        (a, b)
        for values in films_values
        for a, b in itertools.combinations(values, 2)
        if round(abs(a[0] - b[0]), 6) >= APART
    ]
    right = [(a[0] - b[0]) * (a[1] - b[1]) > 0 for a, b in pairs]
    return Ranked(
        len(everything),
        spearman(everything),
        fmean(within) if within else math.nan,
        len(pairs),
        fmean(right) if right else math.nan,
    )


def spearman(pairs: Iterable[tuple[float, float]]) -> float:
    """Correlation of the ranks of pairs, equal values sharing their mean rank; nan of fewer than 3, or where one side
    does not vary."""
    values = np.array(list(pairs), np.float64).reshape(-1, 2)
    ranks = [_ranks(values[:, side]) for side in range(2)]
    if len(values) < 3 or any(np.ptp(each) == 0 for each in ranks):
        return math.nan
    return float(np.corrcoef(ranks)[0, 1])


def _ranks(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return np.asarray((last - (counts - 1) / 2)[place], np.float64)
