"""The blocks of benchmarks/RESULTS-films.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from records.film_aims import (
    FORM_BEHIND,
    LEAST_BEHIND,
    LOW,
    aims,
    behind,
    low,
    near_the_best_form,
)
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

MOST_NAMED = 20
"""Films that are named, at most, where an aim is missed."""


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
        "[Films](benchmarks/RESULTS-films.md) has all of them."
    )


def aimed_at(records: Records) -> str:
    """Aims, and which of them are missed."""
    found = aims(_films(records), _films(records, True))
    missed = [aim.name for aim in found if not aim.met]
    said = "All of these aims are met." if not missed else f"Of these {len(found)} aims {len(missed)} are missed: "
    rows = [[aim.name, aim.reached, "yes" if aim.met else "**no**"] for aim in found]
    return f"{table(['aim', 'measured', 'met'], rows)}\n\n{wrapped(said + '; '.join(missed) + '.' * bool(missed))}"


def jod(records: Records) -> str:
    """Mean JOD by method, scene and sampler."""
    found = _films(records)
    return _means([*_places(found), ("all", found)])


def jod_strata(records: Records) -> str:
    """Mean JOD by method and kind of set."""
    return _means(_strata(_films(records)))


def beside_linear(records: Records) -> str:
    """How auto and the network stand beside LINEAR, film by film."""
    found, rows = _films(records), []
    for method in SUBJECTS:
        for title, some in _parts(found):
            each = gain(some, method)
            worst, best = (f"{each.film_gain(film):+.2f} ({film.set})" for film in (each.worst, each.best))
            rows.append([method, title, str(len(some)), f"{each.mean:+.2f}", worst, best, f"{each.above:.0%}"])
    return table(["method", "films", "how many", "mean", "worst", "best", "above"], rows)


def misses(records: Records) -> str:
    """Films in which auto is behind LINEAR by more than it may be."""
    found = behind(_films(records), AUTO, LEAST_BEHIND)
    if not found:
        return wrapped(f"`{AUTO}` is in no film more than {LEAST_BEHIND:g} JOD behind `{LINEAR}`.")
    rows = [
        [film.name, *(f"{film.jod(name):.2f}" for name in (LINEAR, AUTO, NEURAL)), f"{film.over(AUTO):+.2f}"]
        for film in found[:MOST_NAMED]
    ]
    more = len(found) - len(rows)
    said = f"`{AUTO}` is more than {LEAST_BEHIND:g} JOD behind `{LINEAR}` in {len(found)} films, the farthest first."
    said += f" The table leaves out {more} of them, which are closer." if more else ""
    return f"{wrapped(said)}\n\n{table(['film', LINEAR, AUTO, NEURAL, f'{AUTO} over {LINEAR}'], rows)}"


def low_films(records: Records) -> str:
    """What is won where something can be won."""
    found = low(_films(records))
    if not found:
        return wrapped(f"`{LINEAR}` is below {LOW:g} JOD in no film.")
    rows = [
        [name, f"{mean_jod(found, name):.2f}", f"{gain(found, name).mean:+.2f}", f"{gain(found, name).above:.0%}"]
        for name in found[0].methods
        if name != LINEAR
    ]
    said = f"`{LINEAR}` is below {LOW:g} JOD in {len(found)} films, and has {mean_jod(found, LINEAR):.2f} JOD there."
    return f"{wrapped(said)}\n\n{table(['method', 'mean JOD', f'over {LINEAR}', 'above'], rows)}"


def best_form(records: Records) -> str:
    """How often auto and the network keep up with the best closed form of a film."""
    found = _films(records)
    rows = [
        [title, *(f"{near_the_best_form(some, method):.0%}" for method in SUBJECTS)] for title, some in _parts(found)
    ]
    heads = ["films", *(f"{method}, at most {FORM_BEHIND:g} JOD behind" for method in SUBJECTS)]
    return table(heads, rows)


def forms(records: Records) -> str:
    """The network beside every closed form."""
    found, mine = _films(records), mean_jod(_films(records), NEURAL)
    means = {name: mean_jod(found, name) for name in found[0].forms}
    rows = [
        [name, f"{mean:.2f}", f"{mine - mean:+.2f}", f"{gain(found, NEURAL, name).above:.0%}"]
        for name, mean in sorted(means.items(), key=lambda each: -each[1])
    ]
    ahead = [name for name, mean in means.items() if mean >= mine]
    said = f"The mean of `{NEURAL}` is {mine:.2f} JOD. "
    said += (
        f"The means of {_listed([f'`{name}`' for name in ahead])} are not below it."
        if ahead
        else "The mean of every closed form is below it."
    )
    heads = ["closed form", "mean JOD", f"{NEURAL} over it", f"films with {NEURAL} above it"]
    return f"{table(heads, rows)}\n\n{wrapped(said)}"


def steady(records: Records) -> str:
    """Flicker and false sparkle."""
    return _steady(_films(records))


def steady_words(records: Records) -> str:
    """What the table of flicker and sparkle means."""
    found = _films(records)
    return wrapped(
        f"The reference changes enough for a figure of flicker in {len(moving(found, LINEAR))} of {len(found)} films. "
        f"Flicker is within 25 % where it is from {STEADY[0]:g} to {STEADY[1]:g} times the reference's. The reference "
        "has no false sparkle, because false sparkle is what the reference does not have. So nothing can lie within "
        f"25 % of it, and the table compares with `{LINEAR}` instead: a film counts where its false sparkle is at most "
        f"{SPARKLE_MORE:g} times the false sparkle of `{LINEAR}`, or below {NO_SPARKLE:g}, which is as good as none (a "
        f"guess). `{LINEAR}` has that little in {share(found, lambda film: _sparkle(film, LINEAR) <= NO_SPARKLE):.0%} "
        "of films."
    )


def accumulated_jod(records: Records) -> str:
    """Mean JOD of accumulated films, and how methods stand beside LINEAR under each sampler."""
    found, rows = _films(records, True), []
    parts = _by(found, lambda film: film.sampler)
    for method in found[0].methods:
        if method == LINEAR:
            continue
        for title, some in parts:
            each, hard = gain(some, method), low(some)
            worst, best = (f"{each.film_gain(film):+.2f} ({film.set})" for film in (each.worst, each.best))
            won = f"{gain(hard, method).mean:+.2f} in {len(hard)}" if hard else "no such film"
            rows.append([method, title, f"{each.mean:+.2f}", won, worst, best, f"{each.above:.0%}"])
    heads = ["method", "sampler", "mean", f"where {LINEAR} is below {LOW:g}", "worst", "best", "above"]
    return f"{_means([*_places(found), ('all', found)])}\n\n{table(heads, rows)}"


def accumulated_steady(records: Records) -> str:
    """Flicker and false sparkle of accumulated films."""
    return _steady(_films(records, True))


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


def _places(found: Sequence[Film]) -> list[tuple[str, list[Film]]]:
    """Title to films: of each scene and sampler."""
    parts = dict(_by(found, lambda film: f"{film.scene}, {film.sampler}"))
    titles = [f"{scene}, {sampler}" for scene in _scenes(found) for sampler in _samplers(found)]
    return [(title, parts[title]) for title in titles]


def _strata(found: Sequence[Film]) -> list[tuple[str, list[Film]]]:
    """Title to films: of each kind of set."""
    return sorted(_by(found, lambda film: film.stratum))


def _parts(found: Sequence[Film]) -> list[tuple[str, list[Film]]]:
    """Title to films: of each scene and sampler, of each kind of set, and all."""
    return [*_places(found), *_strata(found), ("all", list(found))]


def _strata_words(found: Sequence[Film]) -> str:
    counts = [f"{len({film.set for film in some})} are {title.replace(',', ' and')}" for title, some in _strata(found)]
    return (
        f"A set is glossy where its mean roughness is below {GLOSSY:g}, and bumpy where the root mean square of its "
        f"slopes is {BUMPY:g} or more: {_listed(counts)}."
    )


def _means(parts: Sequence[tuple[str, Sequence[Film]]]) -> str:
    """Mean JOD, methods down and films across; the best of a column is bold."""
    shown = {name: [round(mean_jod(some, name), 2) for _, some in parts] for name in parts[0][1][0].methods}
    most = [max(column) for column in zip(*shown.values(), strict=True)]
    rows = [
        [
            name,
            *(f"**{value:.2f}**" if value == best else f"{value:.2f}" for value, best in zip(row, most, strict=True)),
        ]
        for name, row in shown.items()
    ]
    return table(["mean JOD", *(title for title, _ in parts)], rows)


def _steady(found: Sequence[Film]) -> str:
    rows = []
    for name in found[0].methods:
        moved = moving(found, name)
        flicker = np.array([film.figures[name]["flicker"] for film in moved])
        shares = [np.mean(each) if flicker.size else math.nan for each in (flicker < STEADY[0], flicker > STEADY[1])]
        calm = share(moved, lambda film, name=name: film.is_steady(name))  # type: ignore[misc]
        clean = share(found, lambda film, name=name: not film.sparkles(name))  # type: ignore[misc]
        sparkle = 1000 * float(np.mean([_sparkle(film, name) for film in found]))
        median = np.median(flicker) if flicker.size else math.nan
        rows.append(
            [
                name,
                f"{calm:.0%}",
                *(f"{each:.0%}" for each in shares),
                f"{median:.2f}",
                f"{clean:.0%}",
                f"{sparkle:.2f}",
            ]
        )
    heads = [
        "method", "flicker within 25 %", "too calm", "too restless", "median flicker", f"sparkle as {LINEAR}",
        "mean false sparkle, thousandths",
    ]  # fmt: skip
    return table(heads, rows)


def _sparkle(film: Film, name: str) -> float:
    return film.figures[name]["sparkle"]


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)


FILM_VIEWS: Mapping[str, Callable[[Any], str]] = {
    "short": short,
    "setup": setup,
    "aims": aimed_at,
    "jod": jod,
    "jod-strata": jod_strata,
    "beside-linear": beside_linear,
    "misses": misses,
    "low": low_films,
    "best-form": best_form,
    "forms": forms,
    "steady": steady,
    "steady-words": steady_words,
    "accumulated": accumulated_jod,
    "accumulated-steady": accumulated_steady,
    "ranks": ranks,
}
"""Name of a block, behind `films/`, to what makes its text."""
