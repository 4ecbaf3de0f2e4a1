"""The page itself: its sections, from top to bottom, around the styles and the script beside this file.

The interactive view comes first, then the verdict, films in step and one table. Everything else is folded away.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from importlib.resources import files
from string import Template

from mipbake.base.timings import Progress
from mipbake.comparing.page.charts import curves
from mipbake.comparing.page.facts import bullets, details
from mipbake.comparing.page.markup import SPACE, Content, Html, element, folded, joined, note
from mipbake.comparing.page.names import called
from mipbake.comparing.page.scenes import films, other_films, pictures, plots
from mipbake.comparing.page.tables import curve_table, measure_tables, seen_table
from mipbake.comparing.page.texels import thumbnails, view
from mipbake.comparing.page.verdict import best_in_renders, verdict
from mipbake.comparing.result import LINEAR, Comparison
from mipbake.material.filtered_source import FilteredSource

RESULTS = "results.json"
"""The file of figures, which the page links to."""

_UNMEASURED = (
    "Everything is still being measured. The verdict, films and figures come up here by themselves; if mipbake was "
    "stopped, this is all."
)


def document(comparison: Comparison, source: FilteredSource | None, begun: bool, progress: Progress) -> str:
    """The page's HTML; arguments of `write_report`."""
    done, total = 0, len(comparison.films) + len(comparison.rendered) + len(comparison.plots) + 2

    def step() -> None:
        nonlocal done
        done += 1
        progress(done / (total + 1))

    live = view(comparison, source)
    step()
    parts = [
        element("header", element("h1", comparison.name, element("small", "plain MIP maps beside mipbake"))),
        element("section", live, id="view", aria_label="Interactive view") if live else None,
        element("main", _first(comparison, begun, step), _details(comparison, step)),
    ]
    # The template's own text holds no `$` but its fields; values are not searched for fields.
    return Template(_text("page.html")).substitute(
        title=joined(f"{comparison.name} · mipbake"),
        style=_text("page.css"),
        body=joined(parts),
        script=_text("page.js"),
    )


def _text(name: str) -> str:
    return files(__package__ or "mipbake.comparing.page").joinpath(name).read_text(encoding="utf-8")


def _first(comparison: Comparison, begun: bool, step: Callable[[], None]) -> Iterator[Html]:
    """What is read first: the verdict, what a reader can do, films in step, and the table."""
    if begun:
        yield element("p", _UNMEASURED, id="begun")
    elif comparison.figures:
        yield element("p", _typed(verdict(comparison).sentence), id="verdict")
    if comparison.warnings:
        yield element("aside", bullets(comparison.warnings), class_="warnings", aria_label="Warnings")
    if comparison.films:
        yield _section("films", "In motion", films(comparison, step))
    if table := seen_table(comparison):
        yield _section("table", "What one sees", table)


def _details(comparison: Comparison, step: Callable[[], None]) -> Html:
    """Everything else, with headings of its own."""
    renders = note(
        "Each method looks its stack up once for each pixel. The truth is supersampled until its own noise is far "
        f"below the error of the closest method. Radiance x is shown as {'x / (1 + x)'.replace(' ', SPACE)}. Below "
        "each picture, FLIP maps its difference from the truth."
    )
    measured = bool(comparison.figures)
    parts: list[tuple[str, str, Content]] = [
        ("notes", "Notes", bullets(comparison.notes) if comparison.notes else None),
        ("decibels", "Verdict in decibels", _in_decibels(comparison) if measured else None),
        ("others", "Other methods in films", other_films(comparison)),
        ("pictures", "Renders", [renders, pictures(comparison, step)] if comparison.rendered else None),
        ("curves", "Signal to noise over level of detail", _curves(comparison) if comparison.curve else None),
        ("plots", "Change and lobes", plots(comparison, step) if comparison.plots else None),
        ("figures", "Every measure", measure_tables(comparison) if measured else None),
        ("maps", "Maps and levels", thumbnails(comparison) if measured else None),
    ]
    step()
    parts.append(("made", "How this was made", details(comparison, RESULTS)))
    names = {called(comparison, name): name for name in (LINEAR, comparison.subject)}
    text = f"Methods are called as in commands and files: {'; '.join(f'{key}, {name}' for key, name in names.items())}."
    sections = [note(text), [_section(*part) for part in parts if part[2]]]
    what = "all methods, measures and pictures" if measured else "how this was made"
    return element("details", element("summary", f"Details: {what}"), sections, id="details")


def _in_decibels(comparison: Comparison) -> list[Html]:
    found = verdict(comparison)
    sure = "where its 95 % interval, over the same light-view pairs for both methods, does not hold 0"
    counts = (
        "Decibels are of the signal-to-noise ratio (SNR): 10 dB more is a tenth of the squared error. A difference "
        f"counts {sure if found.paired else 'where the 95 % intervals of the two figures do not overlap'}."
    )
    return [note(each) for each in (found.details, best_in_renders(comparison), counts) if each]


def _typed(sentence: str) -> list[Html | str]:
    """A sentence with what is to be typed as code, which no line breaks."""
    parts = re.split(r"(--[\w-]+(?: [\w.]+)?(?: --[\w-]+(?: [\w.]+)?)*)", sentence)
    return [element("code", part) if part.startswith("--") else part for part in parts]


def _section(key: str, title: str, content: Content) -> Html:
    return element("section", element("h2", title, id=f"{key}-title"), content, id=key, aria_labelledby=f"{key}-title")


def _curves(comparison: Comparison) -> list[Html]:
    text = (
        "Bands are 95 % intervals over light-view pairs. All methods were measured with the same pairs, so differences "
        "between methods are surer than the bands suggest."
    )
    return [note(text), curves(comparison), folded("The curves as tables", curve_table(comparison))]
