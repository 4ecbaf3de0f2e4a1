"""Renders and the paper's figures: every method's picture beside the reference, with its FLIP map below.

Each picture lies in the page once, in a strip that scrolls sideways. The script builds the view with the divider from
the strips, so a reader without scripts and a printer have all pictures too.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence

import numpy as np

from mipbake.comparing.page.markup import Html, element
from mipbake.comparing.page.methods import REFERENCE, standing_out
from mipbake.comparing.page.pictures import Album, Picture, displayed_bytes, gradient_stops, heat
from mipbake.comparing.page.tables import number, title, unit
from mipbake.comparing.ranking import LINEAR
from mipbake.comparing.result import Comparison, Plot, Rendered, Scene
from mipbake.quality.figures import Figure
from mipbake.quality.metrics import MEASURES


def flip_top(comparison: Comparison) -> float:
    """The error that the maps' last colour stands for: what 1 in 500 pixels exceeds, rounded up to tenths, up to 1."""
    maps = [flip.ravel() for each in comparison.rendered for flip in each.flip.values() if flip.size]
    if not maps:
        return 1.0
    top = float(np.nanquantile(np.concatenate(maps), 0.998))
    return min(max(math.ceil(10 * top - 1e-6) / 10, 0.1), 1.0)


def scenes(comparison: Comparison, album: Album, progress: Callable[[], None]) -> Html:
    """The section's pictures: a figure for each scene."""
    top = flip_top(comparison)
    order = _ordered(comparison)
    return element(
        "div", [_scene(comparison, each, order, top, album, progress) for each in comparison.rendered], class_="scenes"
    )


def colour_bar(top: float) -> Html:
    """What the colours of the error maps stand for."""
    ticks = [0, round(top / 2, 2), top]
    last = f"{ticks[-1]:g}" + ("" if top >= 1 else " and more")
    stops = ", ".join(f"{colour} {100 * share:.1f}%" for share, colour in gradient_stops())
    return element(
        "figure",
        element(
            "div",
            class_="ramp",
            style=f"background: linear-gradient(to right, {stops})",
            role="img",
            aria_label=f"Colours from black for 0 to pale yellow for {last}",
        ),
        element(
            "div",
            [element("span", f"{t:g}" if t != ticks[-1] else last) for t in ticks],
            class_="ramp-ticks",
            aria_hidden="true",
        ),
        class_="colour-bar",
    )


def _ordered(comparison: Comparison) -> list[str]:
    """Names of all methods, those that stand out first."""
    first = standing_out(comparison)
    return first + [m.name for m in comparison.methods if m.name not in first]


def _scene(
    comparison: Comparison,
    rendered: Rendered,
    order: Sequence[str],
    top: float,
    album: Album,
    progress: Callable[[], None],
) -> Html:
    scene = rendered.scene
    picture = album.add(f"{scene.title}, {REFERENCE}", displayed_bytes(rendered.reference), scene.name, REFERENCE)
    progress()
    cells = [cell(REFERENCE, _shown(picture, f"{scene.title}, the reference", None), None, {})]
    for name in (name for name in order if name in rendered.images):
        picture = album.add(f"{scene.title}, {name}", displayed_bytes(rendered.images[name]), scene.name, name)
        flip = None
        if name in rendered.flip:
            flip = album.add(
                f"{scene.title}, FLIP map of {name}", heat(rendered.flip[name], top), scene.name, name, "flip"
            )
        figures = figures_of(comparison, name, scene.view, scene.scale)
        shown = _shown(picture, f"{scene.title}, {name}", flip)
        cells.append(cell(name, shown, _short(figures), dict(named(f) for f in figures)))
        progress()
    height, width = scene.resolution
    return element(
        "figure",
        element("figcaption", element("h3", scene.title), element("p", _described(scene), class_="note")),
        element("div", class_="compare", hidden=True),
        element("div", cells, class_="strip", tabindex=0, role="region", aria_label=f"{scene.title}: every method"),
        class_="scene" + (" wide" if width > 1.6 * height else ""),
        data_scene=scene.name,
        data_title=scene.title,
    )


def cell(name: str, shown: Sequence[Html], caption: str | None, figures: dict[str, str]) -> Html:
    """A method in a strip: its pictures, its name, a caption, and its figures for the view with the divider."""
    return element(
        "figure",
        list(shown),
        element("figcaption", element("b", name), element("small", caption) if caption else None),
        data_method=name,
        data_figures=json.dumps(figures, ensure_ascii=False) if figures else None,
    )


def _shown(picture: Picture, alt: str, flip: Picture | None) -> list[Html]:
    """A picture and its FLIP map, or the room that one would take."""
    below = (
        flip.html(f"FLIP map: {alt}", class_="flip")
        if flip
        else element("span", class_="no-flip", style=f"aspect-ratio: {picture.width} / {picture.height}")
    )
    return [picture.html(alt, class_="render"), below]


def figures_of(comparison: Comparison, method: str, view: str, scale: str) -> list[Figure]:
    """The figures of a method in a render or a film, in the order of MEASURES."""
    found = [f for f in comparison.figures if (f.method, f.view, f.scale) == (method, view, scale)]
    order = list(MEASURES)
    return sorted(found, key=lambda f: order.index(f.measure) if f.measure in order else len(order))


def named(figure: Figure) -> tuple[str, str]:
    """Title and figure, with its unit, as a reader is shown both."""
    return title(figure.measure, ""), f"{number(figure.value, figure.measure)} {unit(figure.measure)}".strip()


def _short(figures: Sequence[Figure]) -> str | None:
    """The figure below a picture: FLIP where it was measured, for it is the map's mean, else the first one."""
    shown = next((f for f in figures if f.measure == "flip"), figures[0] if figures else None)
    if shown is None:
        return None
    return " ".join(named(shown))


def _described(scene: Scene) -> str:
    share = scene.standard_error / scene.candidate_error if scene.candidate_error > 0 else math.nan
    error = "" if math.isnan(share) else f", its standard error {share:.2g} of the closest method's error"
    less = "" if scene.converged else " (more than was wanted: small differences here are noise)"
    lod = "" if "median" in scene.title else f"Median level of detail {scene.lod:.1f}; "
    text = f"{lod}{scene.lighting}; reference of {scene.passes} samples per pixel{error}{less}."
    return text[0].upper() + text[1:]


# ---- the paper's figures


def plots(comparison: Comparison, album: Album, progress: Callable[[], None]) -> Html:
    """A figure for each plot: the reference, the methods that stand out, the others behind them in the strip."""
    order = _ordered(comparison)
    return element("div", [_plot(plot, order, album, progress) for plot in comparison.plots], class_="plots")


def _plot(plot: Plot, order: Sequence[str], album: Album, progress: Callable[[], None]) -> Html:
    cells = []
    for name in (REFERENCE, *(name for name in order if name in plot.images)):
        image = plot.reference if name == REFERENCE else plot.images[name]
        picture = album.add(f"{plot.title}, {name}", displayed_bytes(image), plot.name, name)
        factor = max(1, round(224 / max(picture.width, 1)))
        shown = picture.html(f"{plot.title}, {name}", class_="render", style=f"--width: {factor * picture.width}px")
        cells.append(element("figure", shown, element("figcaption", element("b", name)), data_method=name))
        progress()
    return element(
        "figure",
        element("figcaption", element("h3", plot.title), element("p", plot.caption, class_="note")),
        element("div", cells, class_="strip", tabindex=0, role="region", aria_label=f"{plot.title}: every method"),
        class_="plot-figure",
    )


def picture_choices(comparison: Comparison) -> tuple[list[str], str, str]:
    """What the view with the divider may show, the reference last, and what A and B are at first."""
    order = _ordered(comparison)
    shown = [name for name in order if any(name in each.images for each in comparison.rendered)]
    start = LINEAR if LINEAR in shown and comparison.subject != LINEAR else REFERENCE
    return [*shown, REFERENCE], start, comparison.subject
