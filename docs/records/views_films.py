"""The blocks of benchmarks/RESULTS-films.md, and the tables of the README that come from films."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any

from scipy.stats import spearmanr

from records.wrapping import table, wrapped

AUTO, NEURAL, LINEAR = "auto", "neural", "linear (box)"

JUDGE = "jod-37"
"""The measure that methods are judged by: ColorVideoVDP at 37 pixels per degree, in JOD."""

STEADY = (0.8, 1.25)
"""Flicker that is within 25 % of the reference: change over the change there should be."""

SPARKLE_MORE, NO_SPARKLE = 1.25, 1e-4
"""False sparkle over that of LINEAR which is within 25 %, and false sparkle that is as good as none."""

APART = 0.1
"""JOD from which the order of two methods in a film counts."""

MEASURES: Mapping[str, tuple[str, int]] = {
    "visible": ("`visible`, what judges and training minimise", -1),
    "flip": ("FLIP", -1),
    "snr-displayed": ("SNR of what is displayed", 1),
    "snr": ("SNR of linear light", 1),
}
"""Measure that is ranked beside the judge to what it is called, and the sign by which more is better."""


@dataclass(frozen=True)
class Film:
    """One film of one set.

    Args:
        set, lighting, scene, sampler: names; the scene is `floor`, `low-floor`, `wall` or `sphere`.
        roughness, slope: of the set: the mean of the map, and the root mean square of the slopes of its bumps.
        converged: whether the reference is as clean as wanted.
        figures: method to measure to figure, without those that are not numbers.
    """

    set: str
    lighting: str
    roughness: float
    slope: float
    scene: str
    sampler: str
    converged: bool
    figures: Mapping[str, Mapping[str, float]]

    def jod(self, method: str) -> float:
        """What the judge says."""
        return self.figures[method][JUDGE]

    def over(self, method: str) -> float:
        """JOD of a method minus JOD of LINEAR."""
        return self.jod(method) - self.jod(LINEAR)

    def is_near_the_best_form(self, method: str) -> bool:
        """Whether it is at most APART behind the best closed form of this film."""
        best = max(self.jod(name) for name in self.figures if name not in (AUTO, NEURAL))
        return round(best - self.jod(method), 6) <= APART

    def sparkles(self, method: str) -> bool:
        """Whether it sparkles more than LINEAR does, by more than 25 %."""
        found, plain = (self.figures[name]["sparkle"] for name in (method, LINEAR))
        return found > max(SPARKLE_MORE * plain, NO_SPARKLE)


def films(data: Mapping[str, Any], accumulated: bool = False) -> list[Film]:
    """The films of a record, under samplers that accumulate frames or under the others."""
    return [
        Film(
            name, each["lighting"], each["roughness"], each["slope"], film["scene"].removeprefix("film-"),
            film["sampler"], film["converged"],
            {m: {k: v for k, v in found.items() if v is not None} for m, found in film["figures"].items()},
        )
        for name, each in data["sets"].items()
        for film in each["films"]
        if film["sampler"].startswith("accumulated") == accumulated
    ]  # fmt: skip


def setup(data: Mapping[str, Any]) -> str:
    """What was filmed."""
    found, effort = films(data), data["effort"]
    scenes, samplers, lit, networks = (
        _listed([*dict.fromkeys(names)])
        for names in (
            (film.scene for film in found),
            (film.sampler for film in found),
            (each["lighting"] for each in data["sets"].values()),
            (f"`{each['network']}`" for each in data["sets"].values()),
        )
    )
    clean, height = sum(film.converged for film in found), effort["height"]
    return wrapped(
        f"There are {len(data['sets'])} texture sets, and {len(found)} films of every method: {scenes}, each with the "
        f"samplers {samplers}. The lightings are {lit}, in turn, a set after the other. A film has {effort['frames']} "
        f"frames of {height * 3 // 2} x {height} pixels. `{NEURAL}` is the network {networks}. The references of "
        f"{clean} films are as clean as wanted within {effort['passes']} samples a pixel; the noise of the other "
        "references counts as error of all methods."
    )


MATTE, GLOSSY, FLAT = 0.8, 0.5, 0.05
"""Mean roughness from which a set is matte, below which it is glossy; slopes of bumps below which it is flat."""

_KINDS: Mapping[str, Callable[[Film], bool]] = {
    f"flat surfaces (slopes below {FLAT:g})": lambda film: film.slope < FLAT,
    f"matte bumps (roughness from {MATTE:g})": lambda film: film.slope >= FLAT and film.roughness >= MATTE,
    f"half matte bumps (roughness {GLOSSY:g} to {MATTE:g})": lambda film: (
        film.slope >= FLAT and GLOSSY <= film.roughness < MATTE
    ),
    f"glossy bumps (roughness below {GLOSSY:g})": lambda film: film.slope >= FLAT and film.roughness < GLOSSY,
    "floors": lambda film: film.scene.endswith("floor"),
    "walls and spheres, one or two texels a pixel": lambda film: not film.scene.endswith("floor"),
    "anisotropic lookups": lambda film: film.sampler == "anisotropic",
    "trilinear lookups": lambda film: film.sampler == "trilinear",
}
"""Row of the README to the films that it is about."""


def where(data: Mapping[str, Any]) -> str:
    """What a reader of the README has to know of films: where they gain, and where they do not."""
    still, moving = films(data), films(data, True)
    parts = {"all films": still, **{title: [film for film in still if is_in(film)] for title, is_in in _KINDS.items()}}
    for bias, title in (("accumulated", ""), ("accumulated, bias -1", ", MIP bias -1")):
        parts[f"temporal antialiasing{title}"] = [film for film in moving if film.sampler == bias]
    rows = []
    for title, some in parts.items():
        gains = [round(film.over(AUTO), 6) for film in some]
        if gains:
            better, worse = (fmean(sign * each >= APART for each in gains) for sign in (1, -1))
            rows.append([title, f"{fmean(gains):+.2f}", f"{better:.0%}", f"{worse:.0%}"])
    sets = len({film.set for film in still})
    lit = [fmean(f.over(AUTO) for f in still if f.lighting == light) for light in {f.lighting for f in still}]
    said = (
        "JOD is how good a film looks to ColorVideoVDP, a model of human sight: 10 is the truth, and one more means "
        f"that three in four people prefer the film. {len(still)} films of {sets} sets that mipbake never saw, and "
        f"{len(moving)} with temporal antialiasing, beside plain MIP maps (better, worse: by {APART:g} JOD or more). "
        f"Lights matter little: {min(lit):+.2f} to {max(lit):+.2f}."
    )
    return f"{wrapped(said)}\n\n{table(['', 'gain, JOD', 'better', 'worse'], rows)}"


_TOOLS: Sequence[tuple[str, str, str, str, str]] = (
    ("maketx 3.2", "averaged", "averaged", LINEAR, "run"),
    ("gltfpack 1.2", "averaged", "averaged", LINEAR, "run"),
    ("glTF-Transform 4.5 (KTX-Software)", "averaged (Lanczos)", "averaged", LINEAR, "source code"),
    ("texconv", "averaged", "averaged", LINEAR, "documentation"),
    ("Unreal: composite texture", "averaged", "widened by the normal map", "unreal (box)", "source code"),
    ("Godot: roughness limiter", "averaged", "the same, to a limit", "godot (box)", "source code"),
    ("mipbake", "fitted to the look", "fitted together", AUTO, "run"),
)
"""Tool, what it does with normals and with roughness, the method whose films show it, and how that is known."""


def tools(data: Mapping[str, Any]) -> str:
    """Other tools that make levels, beside mipbake. A rule that was not filmed with the box, which engines average
    with, has the JOD of the same rule with mipbake's pixel filter, and says so."""
    found, rows = films(data), []
    for tool, normals, roughness, method, known in _TOOLS:
        filmed = method if all(method in film.figures for film in found) else method.replace("(box)", "(gaussian)")
        words = "" if filmed == method else ", with mipbake's filter"
        rows.append([tool, normals, roughness, f"{fmean(film.jod(filmed) for film in found):.2f}{words}", known])
    return table(["tool", "normals", "roughness", "JOD", "known from"], rows)


def jod(data: Mapping[str, Any]) -> str:
    """Mean JOD, methods down, scenes and samplers across; the best of a column is bold."""
    found = films(data)
    titles = [*dict.fromkeys(f"{film.scene}, {film.sampler}" for film in found)]
    parts = [[film for film in found if title == f"{film.scene}, {film.sampler}"] for title in titles] + [found]
    shown = {name: [f"{fmean(film.jod(name) for film in part):.2f}" for part in parts] for name in found[0].figures}
    most = [max(column, key=float) for column in zip(*shown.values(), strict=True)]
    rows = [
        [name, *(f"**{v}**" if v == best else v for v, best in zip(row, most, strict=True))]
        for name, row in shown.items()
    ]
    return table(["mean JOD", *titles, "all"], rows)


def beside_linear(data: Mapping[str, Any]) -> str:
    """How auto and the network stand beside LINEAR, film by film."""
    later = films(data, True)
    parts = {"all": films(data)}
    parts |= {name: [f for f in later if f.sampler == name] for name in dict.fromkeys(f.sampler for f in later)}
    rows = []
    for method, (title, some) in itertools.product((AUTO, NEURAL), parts.items()):
        gains = [film.over(method) for film in some]
        shares = (fmean(gain > 0 for gain in gains), fmean(film.is_near_the_best_form(method) for film in some))
        figures = (f"{each:+.2f}" for each in (fmean(gains), min(gains), max(gains)))
        rows.append([f"{method}: {title}", str(len(some)), *figures, *(f"{each:.0%}" for each in shares)])
    heads = ["films", "how many", "mean", "worst", "best", "above", f"at most {APART:g} behind the best form"]
    return table(heads, rows)


def steady(data: Mapping[str, Any]) -> str:
    """Flicker and false sparkle, without accumulation."""
    found, rows, (least, most) = films(data), [], STEADY
    for name in found[0].figures:
        # Where the reference hardly changes, flicker is no number.
        flicker = [film.figures[name]["flicker"] for film in found if "flicker" in film.figures[name]]
        shares = (
            fmean(least <= each <= most for each in flicker),
            fmean(each < least for each in flicker),
            fmean(each > most for each in flicker),
        )
        clean = fmean(not film.sparkles(name) for film in found)
        rows.append([name, *(f"{each:.0%}" for each in shares), f"{median(flicker):.2f}", f"{clean:.0%}"])
    said = (
        f"Flicker is right where it is from {least:g} to {most:g} times the reference's. The last column is the share "
        f"of films whose false sparkle is at most {SPARKLE_MORE:g} times that of `{LINEAR}`, or below {NO_SPARKLE:g}."
    )
    heads = ["method", "flicker is right", "too calm", "too restless", "median flicker", "sparkle is low"]
    return f"{table(heads, rows)}\n\n{wrapped(said)}"


def ranks(data: Mapping[str, Any]) -> str:
    """Measures beside the judge: rank correlation over all films, and pairs of methods of a film in the right order."""
    found = [*films(data), *films(data, True)]
    pairs = [
        (a, b)
        for film in found
        for a, b in itertools.combinations(film.figures.values(), 2)
        if round(abs(a[JUDGE] - b[JUDGE]), 6) >= APART
    ]
    rows = []
    for measure, (title, sign) in MEASURES.items():
        known = [each for film in found for each in film.figures.values() if measure in each]
        overall = sign * spearmanr([each[JUDGE] for each in known], [each[measure] for each in known]).statistic
        right = fmean(sign * (a[JUDGE] - b[JUDGE]) * (a[measure] - b[measure]) > 0 for a, b in pairs)
        rows.append([title, f"{round(float(overall), 3) + 0.0:.3f}", f"{right:.0%}"])  # and never -0
    said = f"{len(pairs)} pairs of methods were filmed in the same film and differ by {APART:g} JOD or more."
    heads = ["measure", "rank correlation", f"pairs {APART:g} JOD apart in the right order"]
    return f"{table(heads, rows)}\n\n{wrapped(said)}"


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)


_VIEWS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "where": where, "tools": tools, "setup": setup, "jod": jod, "beside-linear": beside_linear, "steady": steady,
    "ranks": ranks,
}  # fmt: skip
FILM_VIEWS: Mapping[str, Callable[[Any], str]] = {
    f"films/{name}": lambda records, view=view: view(records["films"])  # type: ignore[misc]
    for name, view in _VIEWS.items()
}
"""Name of a block to what makes its text."""
