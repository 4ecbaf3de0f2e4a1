"""The blocks of benchmarks/RESULTS-films.md, and the words about films in the README."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from records.films import (
    APART,
    AUTO,
    BUMPY,
    GLOSSY,
    LINEAR,
    NEURAL,
    NO_SPARKLE,
    SPARKLE_MORE,
    STEADY,
    SUBJECTS,
    Film,
    films,
    gain,
    mean_jod,
    moving,
    ranked,
    share,
)
from records.wrapping import table, wrapped

if TYPE_CHECKING:
    from records.record import Records

MEASURES: Mapping[str, tuple[str, bool]] = {
    "visible": ("`visible`, what judges and training minimise", False),
    "flip": ("FLIP", False),
    "snr-displayed": ("SNR of what is displayed", True),
    "snr": ("SNR of linear light", True),
}
"""Measure that is ranked beside the judge to what it is called, and whether more is better."""


def setup(records: Records) -> str:
    """What was filmed."""
    data = records["films"]
    found, effort = films(data, False), data["effort"]
    lit = ", ".join(dict.fromkeys(each["lighting"] for each in data["sets"].values()))
    networks = ", ".join(f"`{name}`" for name in dict.fromkeys(each["network"] for each in data["sets"].values()))
    clean = sum(film.converged for film in found)
    height = effort["height"]
    return wrapped(
        f"There are {len(data['sets'])} texture sets, and {len(found)} films of every method: "
        f"{_listed(_scenes(found))}, each with the samplers {_listed(_samplers(found))}. The lightings are {lit}, in "
        f"turn, a set after the other. {_strata_words(found)} "
        f"A film has {effort['frames']} frames of {height * 3 // 2} x {height} pixels. "
        f"`{NEURAL}` is the network {networks}. The references of {clean} films are as clean as wanted within "
        f"{effort['passes']} samples a pixel; the noise of the other references counts as error of all methods."
    )


def short(records: Records) -> str:
    """What a reader of the README has to know of films."""
    found, accumulated = _films(records), _films(records, True)
    each, later, alone = gain(found, AUTO), gain(accumulated, AUTO).mean, gain(found, NEURAL)
    better, worse = (share(found, lambda film, sign=sign: sign * film.over(AUTO) >= APART) for sign in (1, -1))  # type: ignore[misc]
    return wrapped(
        "What people see is another question. ColorVideoVDP judged "
        f"{len(found)} films of {len({film.set for film in found})} sets: floors, walls and spheres. Its unit "
        "is JOD: one more means that three in four people prefer the film. Beside plain MIP maps, the films of "
        f"`{AUTO}` gain {each.mean:+.2f} JOD in the mean, and from {each.film_gain(each.worst):+.2f} to "
        f"{each.film_gain(each.best):+.2f}. They are better by {APART:g} JOD or more in {better:.0%} of the films, and "
        f"worse by as much in {worse:.0%}. In films with temporal accumulation, which many engines have, the mean is "
        f"{later:+.2f} JOD. The network alone gains {alone.mean:+.2f} JOD, and from "
        f"{alone.film_gain(alone.worst):+.2f}: what `{AUTO}` adds for its time is a guard. "
        "[Films](benchmarks/RESULTS-films.md) has more."
    )


def jod(records: Records) -> str:
    """Mean JOD, methods down, scenes and samplers across; the best of a column is bold."""
    parts = _parts(_films(records))
    shown = {name: [round(mean_jod(some, name), 2) for _, some in parts] for name in parts[0][1][0].methods}
    most = [max(column) for column in zip(*shown.values(), strict=True)]
    rows = [
        [name, *(f"**{v:.2f}**" if v == best else f"{v:.2f}" for v, best in zip(row, most, strict=True))]
        for name, row in shown.items()
    ]
    return table(["mean JOD", *(title for title, _ in parts)], rows)


def beside_linear(records: Records) -> str:
    """How auto and the network stand beside LINEAR, film by film."""
    found, later = _films(records), _films(records, True)
    parts = [("all", found), *_strata(found), *_by(later, lambda film: film.sampler)]
    rows = []
    for method in SUBJECTS:
        for title, some in parts:
            each = gain(some, method)
            ends = (f"{each.film_gain(film):+.2f} ({film.set}, {film.scene})" for film in (each.worst, each.best))
            near = share(some, lambda film, method=method: round(film.behind_the_best_form(method), 6) <= APART)  # type: ignore[misc]
            rows.append(
                [f"{method}: {title}", str(len(some)), f"{each.mean:+.2f}", *ends, f"{each.above:.0%}", f"{near:.0%}"]
            )
    heads = ["films", "how many", "mean", "worst", "best", "above", f"at most {APART:g} behind the best form"]
    return table(heads, rows)


def steady(records: Records) -> str:
    """Flicker and false sparkle, without accumulation."""
    found, rows = _films(records), []
    for name in found[0].methods:
        moved = moving(found, name)
        flicker = np.array([film.figures[name]["flicker"] for film in moved])
        shares = [np.mean(each) if flicker.size else math.nan for each in (flicker < STEADY[0], flicker > STEADY[1])]
        calm = share(moved, lambda film, name=name: film.is_steady(name))  # type: ignore[misc]
        clean = share(found, lambda film, name=name: not film.sparkles(name))  # type: ignore[misc]
        median = np.median(flicker) if flicker.size else math.nan
        rows.append([name, f"{calm:.0%}", *(f"{each:.0%}" for each in shares), f"{median:.2f}", f"{clean:.0%}"])
    least, most = STEADY
    said = (
        f"Flicker is right where it is from {least:g} to {most:g} times the reference's. The last column is the share "
        f"of films whose false sparkle is at most {SPARKLE_MORE:g} times that of `{LINEAR}`, or below {NO_SPARKLE:g}."
    )
    heads = ["method", "flicker is right", "too calm", "too restless", "median flicker", "sparkle is low"]
    return f"{table(heads, rows)}\n\n{wrapped(said)}"


def ranks(records: Records) -> str:
    """Measures beside the judge."""
    found = [*_films(records), *_films(records, True)]
    rows = []
    for measure, (title, higher) in MEASURES.items():
        each = ranked(found, measure, higher)
        rows.append(
            [title, f"{each.overall:.3f}", f"{each.within:.3f}", f"{each.right:.0%}" if each.pairs else "no pair"]
        )
    each = ranked(found, *next((name, higher) for name, (_, higher) in MEASURES.items()))
    said = (
        f"There are {each.triples} triples of set, film and method, with accumulation and without. In {each.pairs} "
        f"pairs of methods both methods were filmed in the same film and differ by {APART:g} JOD or more."
    )
    heads = ["measure", "over all triples", "within a film, mean", f"pairs {APART:g} JOD apart in the right order"]
    return f"{table(heads, rows)}\n\n{wrapped(said)}"


def _films(records: Records, accumulated: bool = False) -> list[Film]:
    return films(records["films"], accumulated)


def _scenes(found: Sequence[Film]) -> list[str]:
    return list(dict.fromkeys(film.scene for film in found))


def _samplers(found: Sequence[Film]) -> list[str]:
    return list(dict.fromkeys(film.sampler for film in found))


def _by(found: Sequence[Film], key: Callable[[Film], str]) -> list[tuple[str, list[Film]]]:
    """Title to films, by what their titles are."""
    return [(title, [film for film in found if key(film) == title]) for title in dict.fromkeys(map(key, found))]


def _strata(found: Sequence[Film]) -> list[tuple[str, list[Film]]]:
    """Title to films: of each kind of set."""
    return sorted(_by(found, lambda film: film.stratum))


def _parts(found: Sequence[Film]) -> list[tuple[str, list[Film]]]:
    """Title to films: of each scene and sampler, and all."""
    return [*_by(found, lambda film: f"{film.scene}, {film.sampler}"), ("all", list(found))]


def _strata_words(found: Sequence[Film]) -> str:
    counts = [f"{len({film.set for film in some})} are {title.replace(',', ' and')}" for title, some in _strata(found)]
    return (
        f"A set is glossy where its mean roughness is below {GLOSSY:g}, and bumpy where the root mean square of its "
        f"slopes is {BUMPY:g} or more: {_listed(counts)}."
    )


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)


FILM_VIEWS: Mapping[str, Callable[[Any], str]] = {
    "short": short,
    "setup": setup,
    "jod": jod,
    "beside-linear": beside_linear,
    "steady": steady,
    "ranks": ranks,
}
"""Name of a block, behind `films/`, to what makes its text."""
