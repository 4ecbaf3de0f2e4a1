"""Films, renders and the paper's plots.

A film is one picture for each method, its frames below each other, which the script draws on canvases from one clock;
without scripts the first frame is seen. A reader without scripts and a printer have all pictures too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.page.charts import standing_out
from mipbake.comparing.page.markup import Html, element, note, region
from mipbake.comparing.page.names import called, distance
from mipbake.comparing.page.pictures import displayed_bytes, gradient_stops, heat, picture
from mipbake.comparing.page.tables import number, title, unit
from mipbake.comparing.result import LINEAR, Comparison, Filmed, FilmedScene, Plot, Rendered, Scene
from mipbake.comparing.viewer import TRUTH

_NOISY = " (more than was wanted: small differences here are noise)"


def _ordered(comparison: Comparison) -> list[str]:
    """Names of all methods, those that stand out first."""
    return list(dict.fromkeys([*standing_out(comparison), *(each.name for each in comparison.methods)]))


def films(comparison: Comparison, step: Callable[[], None]) -> Html:
    """Films in step, near ones first: plain MIP maps, the subject and the reference; `step` is called after each."""
    made, names = [], {name: called(comparison, name) for name in (LINEAR, comparison.subject, TRUTH)}
    for filmed in sorted(comparison.films, key=lambda filmed: filmed.scene.lod):
        moves = "the camera moves" if filmed.scene.motion == "camera" else "the lights move"
        made.append(_in_step(filmed, names, f"{distance(filmed.scene.lod)}; {moves}."))
        step()
    buttons = [
        _button("Stop", "play", "Stop or play the films (space bar)"),
        _button("\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}", "back", "The frame before (,)"),
        _button("\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}", "on", "The frame after (.)"),
        element("output", aria_label="Frame"),
    ]
    text = note(
        "Plain MIP maps left, mipbake next, then the truth: the source as it should look. Watch what glitters or "
        "crawls on one side and not in the truth."
    )
    return Html(text + element("div", buttons, class_="clock js") + element("div", made, class_="films"))


def other_films(comparison: Comparison) -> Html:
    """Films of all other methods, and how films were made; empty without films."""
    names = {name: name for name in _ordered(comparison) if name not in (LINEAR, comparison.subject)}
    made = [_in_step(filmed, names, _film_described(filmed.scene)) for filmed in comparison.films]
    return element("div", made, class_="films others") if made else Html("")


def _in_step(filmed: Filmed, names: Mapping[str, str], text: str) -> Html:
    """A film of the methods that have these names for readers, as far as they were filmed, above a text."""
    scene, shown = filmed.scene, []
    height, width = scene.resolution
    style = f"--natural: {width}px; aspect-ratio: {width} / {height}"
    for name, said in names.items():
        frames = filmed.reference if name == TRUTH else filmed.images.get(name)
        if frames is not None:
            sheet = picture(frames.reshape(-1, *frames.shape[2:]), f"{scene.title}, {said}", 80, class_="sheet")
            frame = element("div", sheet, class_="frame", style=style)
            shown.append(element("figure", frame, element("figcaption", said), data_method=name))
    caption = element("figcaption", element("h3", scene.title), note(text))
    fps = f"{scene.frames_per_second:g}"
    strip = element("div", shown, class_="strip")
    return element("figure", strip, caption, class_="film", data_frames=scene.frames, data_fps=fps)


def _button(label: str, do: str, described: str) -> Html:
    named = None if label.isalpha() else described
    return element("button", label, type="button", data_do=do, title=described, aria_label=named)


def pictures(comparison: Comparison, step: Callable[[], None]) -> Html:
    """A figure for each scene that was rendered, with the error maps; `step` is called after each."""
    names, top, made = _ordered(comparison), flip_top(comparison), []
    for rendered in comparison.rendered:
        made.append(_picture(comparison, rendered, names, top))
        step()
    return Html(_colour_bar(top) + element("div", made, class_="scenes"))


def plots(comparison: Comparison, step: Callable[[], None]) -> Html:
    """A figure for each plot: the reference, the methods that stand out, the others behind them in the strip."""
    names, made = _ordered(comparison), []
    for plot in comparison.plots:
        cells = []
        for name, image in _reference_first(plot, names):
            width = max(1, round(224 / max(image.shape[1], 1))) * image.shape[1]
            shown = picture(displayed_bytes(image), f"{plot.title}, {name}", style=f"--width: {width}px")
            cells.append(_cell(name, [shown]))
        made.append(_figure(plot.title, plot.caption, cells))
        step()
    return element("div", made, class_="scenes")


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
    ramp = element(
        "div",
        class_="ramp",
        style=f"background: linear-gradient(to right, {gradient_stops()})",
        role="img",
        aria_label=f"Colours from black for 0 to pale yellow for {last}",
    )
    ticks = [element("span", tick) for tick in ("0", f"{round(top / 2, 2):g}", last)]
    return element("figure", ramp, element("div", ticks, class_="ramp-ticks", aria_hidden="true"), class_="colour-bar")


def _picture(comparison: Comparison, rendered: Rendered, names: Sequence[str], top: float) -> Html:
    scene, cells = rendered.scene, []
    for name, image in _reference_first(rendered, names):
        alt = f"{scene.title}, {name}"
        size = f"--width: {scene.resolution[1]}px"
        shown = [picture(displayed_bytes(image), alt, style=size)]
        if name in rendered.flip:
            shown.append(picture(heat(rendered.flip[name], top), f"FLIP map: {alt}", style=size))
        found = comparison.find(name, "flip", scene.view, scene.scale)
        caption = f"{title('flip')} {number(found.value, 'flip')} {unit('flip')}" if found else None
        cells.append(_cell(name, shown, caption))
    return _figure(scene.title, _described(scene), cells)


def _reference_first(shown: Rendered | Plot, names: Sequence[str]) -> list[tuple[str, NDArray[Any]]]:
    return [(TRUTH, shown.reference), *((name, shown.images[name]) for name in names if name in shown.images)]


def _figure(heading: str, described: str, cells: Sequence[Html]) -> Html:
    caption = element("figcaption", element("h3", heading), note(described))
    return element("figure", caption, region(f"{heading}: every method", cells, class_="strip"))


def _cell(name: str, shown: Sequence[Html], caption: str | None = None) -> Html:
    """A method in a strip: its pictures, its name, and a caption."""
    words = element("figcaption", element("b", name), element("small", caption) if caption else None)
    return element("figure", shown, words, data_method=name)


def _described(scene: Scene) -> str:
    share = scene.standard_error / scene.candidate_error if scene.candidate_error > 0 else math.nan
    error = "" if math.isnan(share) else f", its standard error {share:.2g} of the closest method's error"
    lod = "" if "median" in scene.title else f"Median level of detail {scene.lod:.1f}; "
    text = f"{lod}{scene.lighting}; truth of {scene.passes} samples per pixel{error}"
    return f"{text[0].upper()}{text[1:]}{'' if scene.converged else _NOISY}."


def _film_described(scene: FilmedScene) -> str:
    return (
        f"{scene.lighting[0].upper()}{scene.lighting[1:]}; sampler {scene.sampler}; median level of "
        f"detail {scene.lod:.1f}; truth of {scene.passes} samples per pixel, its noise {scene.noise:.2g} where the "
        f"closest method's error is {scene.candidate_error:.2g} of the displayed range"
        f"{'' if scene.converged else _NOISY}."
    )
