"""The page itself: its sections, from top to bottom, around the styles and the script beside this file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from string import Template

from mipbake.comparing.page import facts
from mipbake.comparing.page.charts import curves
from mipbake.comparing.page.films import film_choices, films
from mipbake.comparing.page.markup import SPACE, TIMES, Content, Html, element, joined
from mipbake.comparing.page.methods import REFERENCE
from mipbake.comparing.page.pictures import Album
from mipbake.comparing.page.plain import plain
from mipbake.comparing.page.scenes import colour_bar, flip_top, picture_choices, plots, scenes
from mipbake.comparing.page.tables import curve_table, films_table, measure_tables, verdict_table
from mipbake.comparing.page.texels import thumbnail_count, thumbnails, view
from mipbake.comparing.page.verdict import Verdict, best_in_renders, verdict
from mipbake.comparing.result import Comparison
from mipbake.comparing.viewer import Source
from mipbake.stack.stack import MipStack

RESULTS = "results.json"
"""The file of figures, which the page links to."""

_PAIRED = (
    "A difference counts where its 95 % interval, over the same light-view pairs for both methods, does not hold 0."
)
_SEPARATE = (
    "No difference means that the 95 % intervals of the two figures overlap, or that both round to the same figure."
)


def document(
    comparison: Comparison,
    stacks: Mapping[str, MipStack],
    source: Source | None,
    album: Album,
    progress: Callable[[float], None],
) -> str:
    """The page's HTML. The pictures are encoded on the way and kept in the album; arguments of `write_report`."""
    step = _steps(comparison, stacks, progress)
    found = verdict(comparison)
    moving = films(comparison, album, step)
    scene_pictures, plot_pictures = scenes(comparison, album, step), plots(comparison, album, step)
    levels = thumbnails(comparison, stacks, album, step)
    live, cropped = view(comparison, stacks, source)
    step()
    sections = [
        ("films", "Films", _films(comparison, moving) if comparison.films else None),
        ("pictures", "Pictures", _pictures(comparison, scene_pictures) if comparison.rendered else None),
        ("curves", "Over level of detail", _curves(comparison)),
        ("figures", "Every measure", _figures(comparison)),
        ("motion", "In motion", _plots(plot_pictures) if comparison.plots else None),
        ("view", "Interactive view", _view(live, cropped) if live else None),
        ("maps", "Maps and levels", _maps(levels) if levels else None),
        ("details", "How this was made", _details(comparison, album)),
    ]
    shown = [(key, title, body) for key, title, body in sections if body]
    body = joined([_head(comparison, found), _navigation(shown), element("main", [_section(*each) for each in shown])])
    # The template's own text holds no `$` but its fields; values are not searched for fields.
    return Template(_text("page.html")).substitute(
        title=joined(f"{comparison.name} · mipbake"),
        style=_text("page.css"),
        body=body,
        script=_text("page.js"),
    )


def _steps(
    comparison: Comparison, stacks: Mapping[str, MipStack], progress: Callable[[float], None]
) -> Callable[[], None]:
    """Counts pictures: what one call of the result tells."""
    shown = [each.images for each in comparison.rendered] + [each.images for each in comparison.plots]
    total = sum(1 + len(images) for images in shown) + len(comparison.films) * len(film_choices(comparison)[0])
    total += thumbnail_count(comparison, stacks) + 1
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        progress(done / (total + 1))

    return step


def _text(name: str) -> str:
    return files(__package__ or "mipbake.comparing.page").joinpath(name).read_text(encoding="utf-8")


def _section(key: str, title: str, body: Content) -> Html:
    return element("section", element("h2", title, id=f"{key}-title"), body, id=key, aria_labelledby=f"{key}-title")


def _head(comparison: Comparison, found: Verdict) -> Html:
    return element(
        "header",
        element("p", "mipbake compare", class_="kicker"),
        element("h1", comparison.name),
        element("p", found.sentence, class_="verdict"),
        _sentences(comparison.warnings, "Warnings", "warnings"),
        films_table(found),
        verdict_table(found),
        element("p", best_in_renders(comparison), class_="note") if comparison.rendered else None,
        element("p", _PAIRED if found.paired else _SEPARATE, class_="note") if found.closed or found.linear else None,
        _sentences(comparison.notes, "Notes", "notes"),
    )


def _sentences(sentences: tuple[str, ...], label: str, kind: str) -> Html:
    if not sentences:
        return Html("")
    return element("aside", element("h2", label), facts.bullets(sentences), class_=kind, aria_label=label)


def _navigation(sections: Sequence[tuple[str, str, Content]]) -> Html:
    links = [element("a", title, href=f"#{key}") for key, title, _ in sections]
    return element("nav", links, aria_label="Sections")


def _bar(choices: tuple[list[str], str, str], *fields: Html) -> Html:
    """What the views with a divider of one section show: the same in all of them."""
    names, start_a, start_b = choices
    settings = json.dumps({"names": names, "a": start_a, "b": start_b, "reference": REFERENCE}, ensure_ascii=False)
    zooms = [("1", "whole picture"), *((str(times), f"{TIMES}{times}") for times in (2, 4, 8))]
    return element(
        "div",
        _select("a", "Left, A", [(name, name) for name in names], start_a),
        _select("b", "Right, B", [(name, name) for name in names], start_b),
        list(fields),
        _select("zoom", "Zoom", zooms, "1"),
        class_="bar js",
        data_settings=settings,
    )


def _films(comparison: Comparison, shown: Html) -> Html:
    keys = element(
        "span",
        " Films run forwards, then backwards, all from one clock. The space bar stops and starts them, and the keys , "
        "and . show the frame before and after. Drag the divider, or move it with the arrow keys.",
        class_="js",
    )
    text = (
        "Each method is shaded once for each pixel of every frame; the reference is supersampled. All frames of a film "
        "have one exposure. ColorVideoVDP says how a film looks beside the reference, in JOD: 10 is no visible "
        "difference, and one less is what three in four people prefer the reference over."
    )
    controls = element(
        "div",
        element("span", "Films"),
        element(
            "div",
            element("button", "Stop", type="button", data_do="play"),
            element(
                "button",
                "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}",
                type="button",
                data_do="back",
                aria_label="The frame before",
            ),
            element(
                "button",
                "\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}",
                type="button",
                data_do="on",
                aria_label="The frame after",
            ),
            element("output", aria_label="Frame"),
        ),
        class_="clock",
    )
    return joined(
        [
            element("p", text, keys),
            _bar(film_choices(comparison), controls),
            shown,
        ]
    )


def _pictures(comparison: Comparison, shown: Html) -> Html:
    which = _select("show", "Show", [("render", "renders"), ("flip", "FLIP maps")], "render")
    bar = _bar(picture_choices(comparison), which)
    return joined(
        [
            element(
                "p",
                "Each method looks its stack up once for each pixel; the reference is supersampled until its own noise "
                "is far below the error of the closest method. Radiance x is shown as "
                f"{'x / (1 + x)'.replace(' ', SPACE)}, sRGB-encoded.",
            ),
            element(
                "p",
                "Below each scene: every method and its FLIP map, which shows where a viewer would notice a difference "
                "from the reference.",
                element(
                    "span",
                    " Drag the divider, or move it with the arrow keys; zoomed in, drag the picture. Click a picture "
                    "of the strip to put it at A, with Shift at B.",
                    class_="js",
                ),
            ),
            bar,
            colour_bar(flip_top(comparison)),
            shown,
        ]
    )


def _select(key: str, label: str, options: list[tuple[str, str]], chosen: str) -> Html:
    made = [element("option", text, value=value, selected=value == chosen) for value, text in options]
    return element("label", element("span", label), element("select", made, name=key, autocomplete="off"))


def _curves(comparison: Comparison) -> Html | None:
    drawn = curves(comparison)
    if not drawn:
        return None
    note = (
        "Bands are 95 % intervals over light-view pairs. They say how far a figure would move with other pairs; all "
        "methods were measured with the same pairs, so differences between methods are surer than the bands suggest."
    )
    return joined([drawn, element("p", note, class_="note"), _folded("The curves as tables", curve_table(comparison))])


def _folded(label: str, content: Html) -> Html:
    return element("details", element("summary", label), content)


def _figures(comparison: Comparison) -> Html | None:
    if not comparison.figures:
        return None
    note = element(
        "p",
        "The best figure of each column is marked; 95 % intervals stand below.",
        element("span", " A click on a column's heading sorts by it.", class_="js"),
        class_="note",
    )
    return joined([note, measure_tables(comparison)])


def _plots(shown: Html) -> Html:
    note = "The paper on pixel-filter-aware MIP maps shows shimmer with these plots. Here they show this material."
    return joined([element("p", note, class_="note"), shown])


def _view(live: Html, cropped: str) -> Html:
    note = (
        "Every level as it was baked, looked up once for each pixel. Turn the surface slowly: what shimmers, "
        f"shimmers here. {cropped}"
    )
    return joined([element("p", note, class_="note"), live])


def _maps(images: Html) -> Html:
    note = (
        "As 8-bit files would look: colours sRGB-encoded, normals as (n + 1) / 2; large levels reduced, small ones "
        "enlarged."
    )
    return joined([element("p", note, class_="note"), images])


def _details(comparison: Comparison, album: Album) -> Html:
    return joined(
        [
            element("h3", "What was found and assumed"),
            facts.found(plain(comparison.source)),
            _folded("The methods, and how long each took to bake", facts.methods(comparison)),
            facts.settings(comparison),
            element("h3", "Files"),
            facts.files(RESULTS, album.files),
        ]
    )
