"""The page itself: its sections, from top to bottom, around the styles and the script beside this file."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.resources import files
from string import Template

from mipbake.comparing.page.charts import curves
from mipbake.comparing.page.facts import bullets, details
from mipbake.comparing.page.markup import SPACE, TIMES, Content, Html, element, folded, joined, note
from mipbake.comparing.page.scenes import REFERENCE, choices, film_names, films, picture_names, pictures, plots
from mipbake.comparing.page.tables import curve_table, measure_tables, verdict_tables
from mipbake.comparing.page.texels import thumbnails, view
from mipbake.comparing.page.verdict import best_in_renders, verdict
from mipbake.comparing.result import Comparison
from mipbake.material.filtered_source import FilteredSource

RESULTS = "results.json"
"""The file of figures, which the page links to."""

_UNMEASURED = (
    "A first page, while everything is measured: it loads itself again as soon as the whole page is there. If mipbake "
    "was stopped, this is all."
)


def document(
    comparison: Comparison, source: FilteredSource | None, begun: bool, progress: Callable[[float], None]
) -> str:
    """The page's HTML; arguments of `write_report`."""
    done, total = 0, len(comparison.films) + len(comparison.rendered) + len(comparison.plots) + 2

    def step() -> None:
        nonlocal done
        done += 1
        progress(done / (total + 1))

    live = view(comparison, source)
    step()
    sections: list[tuple[str, str, Content]] = []
    if comparison.figures:
        sections.append(("verdict", "Verdict", _verdict(comparison)))
    if comparison.films:
        sections.append(("films", "Films", _films(comparison, films(comparison, step))))
    if comparison.rendered:
        sections.append(("pictures", "Pictures", _pictures(comparison, pictures(comparison, step))))
    if comparison.curve:
        sections.append(("curves", "Over level of detail", _curves(comparison)))
    if comparison.plots:
        sections.append(("motion", "In motion", plots(comparison, step)))
    if comparison.figures:
        sections.append(("figures", "Every measure", folded("Tables", measure_tables(comparison))))
    if maps := None if begun else thumbnails(comparison):
        sections.append(("maps", "Maps and levels", folded("Every map, level by level", maps)))
    step()
    made = folded("What was read, set and measured", details(comparison, RESULTS))
    sections.append(("details", "How this was made", made))
    links = [element("a", title, href=f"#{key}") for key, title, _ in sections]
    main = [
        element("section", element("h2", title, id=f"{key}-title"), content, id=key, aria_labelledby=f"{key}-title")
        for key, title, content in sections
    ]
    body = [
        element("header", element("h1", comparison.name), element("p", _UNMEASURED, id="begun") if begun else None),
        element("section", live, id="view", aria_label="Interactive view") if live else None,
        element("nav", links, aria_label="Sections"),
        element("main", _sentences(comparison.warnings, "Warnings", "warnings"), main),
    ]
    # The template's own text holds no `$` but its fields; values are not searched for fields.
    return Template(_text("page.html")).substitute(
        title=joined(f"{comparison.name} · mipbake"),
        style=_text("page.css"),
        body=joined(body),
        script=_text("page.js"),
    )


def _text(name: str) -> str:
    return files(__package__ or "mipbake.comparing.page").joinpath(name).read_text(encoding="utf-8")


def _verdict(comparison: Comparison) -> list[Content]:
    found = verdict(comparison)
    counts = (
        "A difference counts where its 95 % interval, over the same light-view pairs for both methods, does not hold 0."
        if found.paired
        else "No difference means that the 95 % intervals of the two figures overlap, or that both round to the same "
        "figure."
    )
    more = [
        note(found.details),
        note(best_in_renders(comparison)) if comparison.rendered else None,
        note(counts) if found.closed or found.linear else None,
        _sentences(comparison.notes, "Notes", "notes"),
    ]
    return [element("p", found.sentence, class_="verdict"), verdict_tables(found), folded("Details", more)]


def _sentences(sentences: tuple[str, ...], label: str, kind: str) -> Html | None:
    if not sentences:
        return None
    return element("aside", element("h2", label), bullets(sentences), class_=kind, aria_label=label)


def _bar(offered: tuple[list[str], str, str], *fields: Html) -> Html:
    """What the views with a divider of one section show: the same in all of them."""
    names, start_a, start_b = offered
    settings = json.dumps({"names": names, "a": start_a, "b": start_b, "reference": REFERENCE}, ensure_ascii=False)
    zooms = [("1", "whole picture"), *((str(times), f"{TIMES}{times}") for times in (2, 4, 8))]
    return element(
        "div",
        _select("a", "Left, A", [(name, name) for name in names], start_a),
        _select("b", "Right, B", [(name, name) for name in names], start_b),
        fields,
        _select("zoom", "Zoom", zooms, "1"),
        class_="bar js",
        data_settings=settings,
    )


def _select(key: str, label: str, options: list[tuple[str, str]], chosen: str) -> Html:
    made = [element("option", text, value=value, selected=value == chosen) for value, text in options]
    return element("label", element("span", label), element("select", made, name=key, autocomplete="off"))


def _button(label: str, do: str, described: str | None = None) -> Html:
    return element("button", label, type="button", data_do=do, aria_label=described)


def _films(comparison: Comparison, shown: Html) -> list[Html]:
    text = (
        "Each method is shaded once for each pixel of every frame; the reference is supersampled. All frames of a film "
        "have one exposure. ColorVideoVDP says how a film looks beside the reference, in JOD: 10 is no visible "
        "difference, and one less is what three in four people prefer the reference over."
    )
    keys = (
        " Films run forwards, then backwards, all from one clock. The space bar stops and starts them, and the keys , "
        "and . show the frame before and after. Drag the divider, or move it with the arrow keys."
    )
    buttons = [
        _button("Stop", "play"),
        _button("\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}", "back", "The frame before"),
        _button("\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}", "on", "The frame after"),
        element("output", aria_label="Frame"),
    ]
    clock = element("div", element("span", "Films"), element("div", buttons), class_="clock")
    offered = choices(comparison, film_names(comparison))
    return [_bar(offered, clock), shown, folded("Details", element("p", text, element("span", keys, class_="js")))]


def _pictures(comparison: Comparison, shown: Html) -> list[Html]:
    text = (
        "Each method looks its stack up once for each pixel; the reference is supersampled until its own noise is far "
        f"below the error of the closest method. Radiance x is shown as {'x / (1 + x)'.replace(' ', SPACE)}, "
        "sRGB-encoded."
    )
    keys = (
        " Drag the divider, or move it with the arrow keys; zoomed in, drag the picture. Click a picture of the strip "
        "to put it at A, with Shift at B."
    )
    which = _select("show", "Show", [("render", "renders"), ("flip", "FLIP maps")], "render")
    offered = choices(comparison, picture_names(comparison))
    return [_bar(offered, which), shown, folded("Details", element("p", text, element("span", keys, class_="js")))]


def _curves(comparison: Comparison) -> list[Html]:
    text = (
        "Bands are 95 % intervals over light-view pairs. They say how far a figure would move with other pairs; all "
        "methods were measured with the same pairs, so differences between methods are surer than the bands suggest."
    )
    return [curves(comparison), folded("The curves as tables", [note(text), curve_table(comparison)])]
