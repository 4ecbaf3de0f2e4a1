"""Films, renders and the paper's plots: every method's picture beside the reference.

Each picture lies in the page once, in a strip that scrolls sideways. The script builds the view with the divider from
the strips, so a reader without scripts and a printer have all pictures too. A film is one picture for each method, its
frames below each other, which the script draws on canvases from one clock; without scripts the first frame is seen.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.page.charts import standing_out
from mipbake.comparing.page.markup import Html, element, note, region
from mipbake.comparing.page.pictures import displayed_bytes, encoded, gradient_stops, heat
from mipbake.comparing.page.tables import number, title, unit
from mipbake.comparing.page.verdict import verdict
from mipbake.comparing.result import LINEAR, Comparison, Filmed, FilmedScene, Plot, Rendered, Scene
from mipbake.quality.figures import Figure
from mipbake.quality.metrics import MEASURES

REFERENCE = "reference"
"""What a report calls the reference beside the methods."""

_NOISY = " (more than was wanted: small differences here are noise)"


def picture_names(comparison: Comparison) -> list[str]:
    """Names of all methods, those that stand out first."""
    return list(dict.fromkeys([*standing_out(comparison), *(each.name for each in comparison.methods)]))


def film_names(comparison: Comparison) -> list[str]:
    """Whose films the page shows: methods that stand out, the best closed form of each film, and every method that is
    no closed form. All others have figures: a film takes as much room as ten pictures."""
    names = [*standing_out(comparison), *(each.rival for each in verdict(comparison).seen_closed)]
    names += [each.name for each in comparison.methods if each.name not in comparison.closed_forms]
    return [name for name in dict.fromkeys(names) if any(name in each.images for each in comparison.films)]


def choices(comparison: Comparison, names: Sequence[str]) -> tuple[list[str], str, str]:
    """What a view with the divider may show, the reference last, and what A and B are at first."""
    start = LINEAR if LINEAR in names and comparison.subject != LINEAR else REFERENCE
    return [*names, REFERENCE], start, comparison.subject


def films(comparison: Comparison, step: Callable[[], None]) -> Html:
    """A figure for each film; `step` is called after each."""
    names, made = film_names(comparison), []
    for filmed in comparison.films:
        made.append(_film(comparison, filmed, names))
        step()
    return element("div", made, class_="scenes")


def pictures(comparison: Comparison, step: Callable[[], None]) -> Html:
    """A figure for each scene that was rendered, with the error maps; `step` is called after each."""
    names, top, made = picture_names(comparison), flip_top(comparison), []
    for rendered in comparison.rendered:
        made.append(_picture(comparison, rendered, names, top))
        step()
    return Html(_colour_bar(top) + element("div", made, class_="scenes"))


def plots(comparison: Comparison, step: Callable[[], None]) -> Html:
    """A figure for each plot: the reference, the methods that stand out, the others behind them in the strip."""
    names, made = picture_names(comparison), []
    for plot in comparison.plots:
        made.append(_plot(plot, names))
        step()
    return element("div", made, class_="plots")


def flip_top(comparison: Comparison) -> float:
    """The error that the maps' last colour stands for: what 1 in 500 pixels exceeds, rounded up to tenths, up to 1."""
    maps = [flip.ravel() for each in comparison.rendered for flip in each.flip.values() if flip.size]
    if not maps:
        return 1.0
    top = float(np.nanquantile(np.concatenate(maps), 0.998))
    return min(max(math.ceil(10 * top - 1e-6) / 10, 0.1), 1.0)


def _colour_bar(top: float) -> Html:
    """What the colours of the error maps stand for."""
    last = f"{top:g}" + ("" if top >= 1 else " and more")
    stops = ", ".join(f"{colour} {100 * share:.1f}%" for share, colour in gradient_stops())
    ramp = element(
        "div",
        class_="ramp",
        style=f"background: linear-gradient(to right, {stops})",
        role="img",
        aria_label=f"Colours from black for 0 to pale yellow for {last}",
    )
    ticks = [element("span", tick) for tick in ("0", f"{round(top / 2, 2):g}", last)]
    return element("figure", ramp, element("div", ticks, class_="ramp-ticks", aria_hidden="true"), class_="colour-bar")


def _film(comparison: Comparison, filmed: Filmed, names: Sequence[str]) -> Html:
    scene, cells = filmed.scene, []
    style = f"aspect-ratio: {scene.resolution[1]} / {scene.resolution[0]}"
    for name, frames in _reference_first(filmed, names):
        alt = f"{scene.title}, {name}"
        sheet = frames.reshape(-1, *frames.shape[2:])
        picture = encoded(sheet, 85)
        shown = element("div", picture.html(alt, class_="render"), class_="frame", style=style)
        figures = _figures(comparison, name, scene.name, "")
        figures.sort(key=lambda f: MEASURES[f.measure].needs != "film")  # what judges films first
        judged = next((f for f in figures if MEASURES[f.measure].needs == "film" or f.measure == "flip"), None)
        value = _named(judged)[1] if judged else None
        caption = f"FLIP {value}" if judged and judged.measure == "flip" else value
        cells.append(_cell(name, [shown], caption, figures))
    return _figure(scene, _film_described(scene), cells, "scene film", data_frames=scene.frames,
                   data_fps=f"{scene.frames_per_second:g}")  # fmt: skip


def _picture(comparison: Comparison, rendered: Rendered, names: Sequence[str], top: float) -> Html:
    scene, cells = rendered.scene, []
    for name, image in _reference_first(rendered, names):
        alt = f"{scene.title}, {name}"
        picture = encoded(displayed_bytes(image), 95)  # readers enlarge it
        flip = encoded(heat(rendered.flip[name], top)) if name in rendered.flip else None
        # The error map, or the room that one would take.
        style = f"aspect-ratio: {picture.width} / {picture.height}"
        below = flip.html(f"FLIP map: {alt}", class_="flip") if flip else element("span", class_="no-flip", style=style)
        figures = _figures(comparison, name, scene.view, scene.scale) if name != REFERENCE else []
        # FLIP where it was measured, for it is the map's mean.
        first = next((f for f in figures if f.measure == "flip"), figures[0] if figures else None)
        caption = " ".join(_named(first)) if first else None
        cells.append(_cell(name, [picture.html(alt, class_="render"), below], caption, figures))
    height, width = scene.resolution
    return _figure(scene, _described(scene), cells, "scene wide" if width > 1.6 * height else "scene")


def _plot(plot: Plot, names: Sequence[str]) -> Html:
    cells = []
    for name, image in _reference_first(plot, names):
        alt = f"{plot.title}, {name}"
        picture = encoded(displayed_bytes(image))
        width = max(1, round(224 / max(picture.width, 1))) * picture.width
        cells.append(_cell(name, [picture.html(alt, class_="render", style=f"--width: {width}px")], None, []))
    return element("figure", _headed(plot.title, plot.caption, cells), class_="plot-figure")


def _reference_first(shown: Filmed | Rendered | Plot, names: Sequence[str]) -> list[tuple[str, NDArray[Any]]]:
    return [(REFERENCE, shown.reference), *((name, shown.images[name]) for name in names if name in shown.images)]


def _figure(scene: Scene | FilmedScene, described: str, cells: Sequence[Html], kind: str, **data: str | int) -> Html:
    """A scene with its strip, and room for the view with the divider."""
    caption, strip = _headed(scene.title, described, cells)
    room = element("div", class_="compare", hidden=True)
    return element("figure", caption, room, strip, class_=kind, data_scene=scene.name, data_title=scene.title, **data)


def _headed(heading: str, described: str, cells: Sequence[Html]) -> tuple[Html, Html]:
    caption = element("figcaption", element("h3", heading), note(described))
    return caption, region(f"{heading}: every method", cells, class_="strip")


def _cell(name: str, shown: Sequence[Html], caption: str | None, figures: Sequence[Figure]) -> Html:
    """A method in a strip: its pictures, its name, a caption, and its figures for the view with the divider."""
    return element(
        "figure",
        shown,
        element("figcaption", element("b", name), element("small", caption) if caption else None),
        data_method=name,
        data_figures=json.dumps(dict(map(_named, figures)), ensure_ascii=False) if figures else None,
    )


def _figures(comparison: Comparison, method: str, view: str, scale: str) -> list[Figure]:
    """The figures of a method in a render or a film, in the order of MEASURES."""
    found = [comparison.find(method, measure, view, scale) for measure in MEASURES]
    return [figure for figure in found if figure]


def _named(figure: Figure) -> tuple[str, str]:
    """Title and figure, with its unit, as a reader is shown both."""
    return title(figure.measure), f"{number(figure.value, figure.measure)} {unit(figure.measure)}".strip()


def _described(scene: Scene) -> str:
    share = scene.standard_error / scene.candidate_error if scene.candidate_error > 0 else math.nan
    error = "" if math.isnan(share) else f", its standard error {share:.2g} of the closest method's error"
    lod = "" if "median" in scene.title else f"Median level of detail {scene.lod:.1f}; "
    text = f"{lod}{scene.lighting}; reference of {scene.passes} samples per pixel{error}"
    return f"{text[0].upper()}{text[1:]}{'' if scene.converged else _NOISY}."


def _film_described(scene: FilmedScene) -> str:
    moving = "the camera moves" if scene.motion == "camera" else "the lights move"
    return (
        f"{scene.lighting[0].upper()}{scene.lighting[1:]}; {moving}; sampler {scene.sampler}; median level of "
        f"detail {scene.lod:.1f}; reference of {scene.passes} samples per pixel, its noise {scene.noise:.2g} where the "
        f"closest method's error is {scene.candidate_error:.2g} of the displayed range"
        f"{'' if scene.converged else _NOISY}."
    )
