"""Films: every method's frames, looping in step, with the divider that pictures have.

A film lies in the page as one picture for each method, its frames below each other. The script draws them on canvases
from one clock. Without scripts the first frame of each is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.page.markup import Html, element
from mipbake.comparing.page.methods import REFERENCE, standing_out
from mipbake.comparing.page.pictures import Album
from mipbake.comparing.page.scenes import cell, figures_of, named
from mipbake.comparing.page.seen import seen
from mipbake.comparing.ranking import LINEAR, closed_forms
from mipbake.comparing.result import Comparison, Filmed, FilmedScene
from mipbake.quality.figures import Figure
from mipbake.quality.metrics import MEASURES


def film_names(comparison: Comparison) -> list[str]:
    """Whose films the page shows: methods that stand out, the best closed form of each film, and every method that is
    no closed form. All others have figures: a film takes as much room as ten pictures."""
    closed, _ = seen(comparison)
    averages = closed_forms(comparison)
    names = [*standing_out(comparison), *(each.rival for each in closed)]
    names += [each.name for each in comparison.methods if each.name not in averages]
    return [name for name in dict.fromkeys(names) if any(name in each.images for each in comparison.films)]


def film_choices(comparison: Comparison) -> tuple[list[str], str, str]:
    """What the view with the divider may show, the reference last, and what A and B are at first."""
    shown = film_names(comparison)
    start = LINEAR if LINEAR in shown and comparison.subject != LINEAR else REFERENCE
    return [*shown, REFERENCE], start, comparison.subject


def films(comparison: Comparison, album: Album, progress: Callable[[], None]) -> Html:
    """The section's films: a figure for each."""
    names = film_names(comparison)
    made = [_film(comparison, each, names, album, progress) for each in comparison.films]
    return element("div", made, class_="scenes")


def _film(
    comparison: Comparison, filmed: Filmed, names: Sequence[str], album: Album, progress: Callable[[], None]
) -> Html:
    scene = filmed.scene
    cells = []
    for name in (REFERENCE, *(name for name in names if name in filmed.images)):
        frames = filmed.reference if name == REFERENCE else filmed.images[name]
        alt = f"{scene.title}, {name}"
        sheet = album.add(f"{alt}, {len(frames)} frames below each other", _sheet(frames), scene.name, name)
        figures = _figures(comparison, scene, name)
        shown = element(
            "div",
            sheet.html(alt, class_="render"),
            class_="frame",
            style=f"aspect-ratio: {scene.resolution[1]} / {scene.resolution[0]}",
        )
        cells.append(cell(name, [shown], _short(figures), dict(named(f) for f in figures)))
        progress()
    return element(
        "figure",
        element("figcaption", element("h3", scene.title), element("p", _described(scene), class_="note")),
        element("div", class_="compare", hidden=True),
        element("div", cells, class_="strip", tabindex=0, role="region", aria_label=f"{scene.title}: films"),
        class_="scene film",
        data_scene=scene.name,
        data_title=scene.title,
        data_frames=scene.frames,
        data_fps=f"{scene.frames_per_second:g}",
    )


def _sheet(frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(T, H, W, 3) frames below each other."""
    return frames.reshape(-1, *frames.shape[2:])


def _figures(comparison: Comparison, scene: FilmedScene, method: str) -> list[Figure]:
    """What was measured, what judges films first."""
    found = figures_of(comparison, method, scene.name, "")
    return sorted(found, key=lambda f: MEASURES[f.measure].needs != "film")


def _short(figures: Sequence[Figure]) -> str | None:
    """The figure below a film: the first of ColorVideoVDP, else FLIP."""
    shown = next((f for f in figures if MEASURES[f.measure].needs == "film" or f.measure == "flip"), None)
    if shown is None:
        return None
    value = named(shown)[1]
    return value if MEASURES[shown.measure].needs == "film" else f"FLIP {value}"


def _described(scene: FilmedScene) -> str:
    moving = "the camera moves" if scene.motion == "camera" else "the lights move"
    less = "" if scene.converged else " (more than was wanted: small differences here are noise)"
    return (
        f"{scene.lighting[0].upper()}{scene.lighting[1:]}; {moving}; sampler {scene.sampler}; median level of "
        f"detail {scene.lod:.1f}; reference of {scene.passes} samples per pixel, its noise {scene.noise:.2g} where the "
        f"closest method's error is {scene.candidate_error:.2g} of the displayed range{less}."
    )
