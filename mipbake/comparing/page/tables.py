"""Tables of a report: every measure by method and scale, the best marked, intervals in small print below figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mipbake.comparing.page.markup import DASH, MINUS, SPACE, Content, Html, element
from mipbake.comparing.page.methods import looks
from mipbake.comparing.page.seen import Seen, spoken
from mipbake.comparing.page.verdict import PLACES, Difference, Verdict
from mipbake.comparing.ranking import LINEAR, OPTIMUM
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import SCALES, SNR_GAIN, Figure
from mipbake.quality.metrics import MEASURES, PAIR_SETS

_BETTER = {
    "higher": "higher is better",
    "lower": "lower is better",
    "one": "1 is right, more shimmers, less is blurred",
}


@dataclass(frozen=True)
class _Column:
    """A column of figures: its heading, the measure, and method to figure."""

    heading: str
    measure: str
    figures: Mapping[str, Figure]


def measure_tables(comparison: Comparison) -> Html:
    """A table for each measure and view with scales as columns; views without scales have measures as columns."""
    tables = []
    for view in _views(comparison):
        here = [f for f in comparison.figures if f.view == view]
        names = _measures(here)
        scales = [scale for scale in SCALES if any(f.scale == scale for f in here)]
        for measure in names:
            columns = [_Column(scale, measure, _by_method(here, measure, scale)) for scale in scales]
            columns = [column for column in columns if column.figures]
            if columns:
                tables.append(
                    _table(comparison, f"{title(measure, comparison.subject)} {_place(view)}", measure, columns)
                )
        columns = [_Column(_with_unit(m), m, _by_method(here, m, "")) for m in names]
        columns = [column for column in columns if column.figures]
        if columns:
            tables.append(_table(comparison, f"Every measure {_place(view)}", None, columns))
    return element("div", tables, class_="tables")


def title(measure: str, subject: str) -> str:
    """What a reader is shown as the name of a measure."""
    if measure == SNR_GAIN:
        return f"SNR of {subject} above the SNR of each method"
    return MEASURES[measure].title if measure in MEASURES else measure


def unit(measure: str) -> str:
    """Unit of a measure; empty where it has none."""
    return "dB" if measure == SNR_GAIN else MEASURES[measure].unit if measure in MEASURES else ""


def number(value: float, measure: str, largest: float | None = None) -> str:
    """A figure as text: one decimal of decibels, two of JOD and of ratios, three digits of anything else.

    `largest` of the figures it stands beside sets how many decimals those are.
    """
    if math.isnan(value):
        return DASH
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if unit(measure) == "dB":
        text = f"{value:+.1f}" if measure == SNR_GAIN else f"{value:.1f}"
    elif unit(measure) == "JOD" or (measure in MEASURES and MEASURES[measure].direction == "one"):
        text = f"{value:.2f}"
    else:
        size = max(abs(value if largest is None else largest), 1e-12)
        decimals = min(max(2 - math.floor(math.log10(size)), 0), 4)
        text = f"{value:.{decimals}f}"
    return text.replace("-", MINUS)


def interval(figure: Figure, largest: float | None = None) -> str:
    """`14.6 to 15.5`, or nothing where a figure has no interval."""
    if math.isnan(figure.low) or math.isnan(figure.high):
        return ""
    low, high = (number(bound, figure.measure, largest) for bound in (figure.low, figure.high))
    return f"{low}{SPACE}to {high}"  # a narrow column breaks it once


def films_table(found: Verdict) -> Html:
    """What films show behind the verdict: a row for each rival, a column for each film."""
    groups = [("the best closed form", found.seen_closed), (LINEAR, found.seen_linear)]
    films = list(dict.fromkeys(each.film for _, group in groups for each in group))
    rows = []
    for name, group in groups:
        here = {each.film: each for each in group}
        if here:
            cells = [_seen_cell(here.get(film)) for film in films]
            rows.append(element("tr", element("th", name, scope="row"), cells))
    if not rows:
        return Html("")
    measure = MEASURES[next(each.measure for _, group in groups for each in group)]
    heads = [element("td"), *(element("th", film.removeprefix("film-"), scope="col") for film in films)]
    title_row = element(
        "tr", element("th", f"In films, {measure.title}, ahead of", scope="rowgroup", colspan=len(films) + 1)
    )
    return element(
        "div",
        element(
            "table", element("thead", element("tr", heads)), element("tbody", title_row, rows), class_="verdict-table"
        ),
        class_="scroll",
        tabindex=0,
        role="region",
        aria_label="What films show",
    )


def verdict_table(found: Verdict) -> Html:
    """The differences behind the verdict: a row for each pair set and rival, a column for each scale."""
    groups = (("the best closed form", found.closed), (LINEAR, found.linear))
    scales = [scale for scale in SCALES if any(d.scale == scale for _, group in groups for d in group)]
    bodies = []
    for view in PAIR_SETS:
        rows = []
        for name, group in groups:
            here = {d.scale: d for d in group if d.view == view}
            if here:
                head = element("th", name, scope="row")
                rows.append(element("tr", head, [_verdict_cell(here.get(scale)) for scale in scales]))
        gaps = [found.gap.get((view, scale)) for scale in scales]
        if any(share is not None for share in gaps):
            head = element("th", "share of the gap to the optimum", scope="row")
            rows.append(element("tr", head, [_gap_cell(share) for share in gaps], class_="gap"))
        if rows:
            place = PLACES[view][0].upper() + PLACES[view][1:]
            title_row = element("tr", element("th", f"{place}, dB ahead of", scope="rowgroup", colspan=len(scales) + 1))
            bodies.append(element("tbody", title_row, rows))
    if not bodies:
        return Html("")
    heads = [element("td"), *(element("th", scale, scope="col") for scale in scales)]
    return element(
        "div",
        element("table", element("thead", element("tr", heads)), bodies, class_="verdict-table"),
        class_="scroll",
        tabindex=0,
        role="region",
        aria_label="Differences behind the verdict",
    )


def _gap_cell(share: float | None) -> Html:
    if share is None:
        return element("td", DASH, title="the optimum is not ahead of the best closed form")
    return element("td", f"{share:.0%}" if share > 0 else "none", title=f"{share:.0%}".replace("-", MINUS))


def _seen_cell(found: Seen | None) -> Html:
    if found is None:
        return element("td", DASH)
    word, kind = {1: ("better", "win"), -1: ("worse", "loss"), 0: ("no visible difference", "tie")}[found.outcome]
    figures = " and ".join(number(f, found.measure, max(found.own, found.other)) for f in (found.own, found.other))
    decimals = 2 if unit(found.measure) == "JOD" else 3
    return element(
        "td",
        element("b", f"{found.gain:+.{decimals}f}".replace("-", MINUS)),
        element("small", word),
        element("small", found.rival) if found.rival != LINEAR else None,
        class_=kind,
        title=f"{figures} {unit(found.measure)}".strip(),
    )


def _verdict_cell(found: Difference | None) -> Html:
    if found is None:
        return element("td", DASH)
    word, kind = {1: ("ahead", "win"), -1: ("behind", "loss"), 0: ("no difference", "tie")}[found.outcome]
    bounds = (
        ""
        if math.isnan(found.low)
        else f"95 % interval {number(found.low, SNR_GAIN)} to {number(found.high, SNR_GAIN)} dB"
    )
    return element(
        "td",
        element("b", number(found.gain, SNR_GAIN)),
        element("small", word),
        element("small", found.rival) if found.rival != LINEAR else None,
        class_=kind,
        title=bounds or None,
    )


def curve_table(comparison: Comparison) -> Html:
    """The figures that the curves are drawn from, at whole levels of detail."""
    tables = []
    for view in PAIR_SETS:
        points = [p for p in comparison.curve if p.view == view and p.lod == int(p.lod)]
        lods = sorted({p.lod for p in points})
        columns = [_Column(f"{lod:g}", "snr", {p.method: p for p in points if p.lod == lod}) for lod in lods]
        if columns:
            tables.append(_table(comparison, f"SNR {PLACES[view]} by level of detail", "snr", columns, "wide"))
    return element("div", tables)


def plain_table(heads: Sequence[str], rows: Sequence[Sequence[Content]], label: str) -> Html:
    """A table of words; the first cell of a row is its heading."""
    return element(
        "div",
        element(
            "table",
            element("thead", element("tr", [element("th", head, scope="col") for head in heads])),
            element(
                "tbody",
                [
                    element("tr", element("th", row[0], scope="row"), [element("td", cell) for cell in row[1:]])
                    for row in rows
                ],
            ),
            class_="words",
        ),
        class_="scroll",
        tabindex=0,
        role="region",
        aria_label=label,
    )


def _views(comparison: Comparison) -> list[str]:
    found = dict.fromkeys(figure.view for figure in comparison.figures)
    return [view for view in PAIR_SETS if view in found] + [view for view in found if view not in PAIR_SETS]


def _measures(figures: Sequence[Figure]) -> list[str]:
    found = dict.fromkeys(figure.measure for figure in figures)
    known = [name for name in MEASURES if name in found]
    gain = [SNR_GAIN] if SNR_GAIN in found else []
    return known[:1] + gain + known[1:] + [name for name in found if name not in MEASURES and name != SNR_GAIN]


def _by_method(figures: Sequence[Figure], measure: str, scale: str) -> dict[str, Figure]:
    return {f.method: f for f in figures if f.measure == measure and f.scale == scale}


def _place(view: str) -> str:
    if view.startswith("film-"):
        return f"in the film of {spoken(view)}"
    return (PLACES | {"rotation": "in a slow rotation"}).get(view, f"on the {view}")


def _with_unit(measure: str) -> str:
    return title(measure, "") + (f", {unit(measure)}" if unit(measure) else "")


def _table(
    comparison: Comparison, heading: str, measure: str | None, columns: Sequence[_Column], kind: str = ""
) -> Html:
    """Methods as rows. Headings of columns are buttons that sort, where scripts run."""
    styles = looks(comparison)
    methods = [name for name in styles if any(name in column.figures for column in columns)]
    heads = [element("th", "Method", scope="col", class_="method")]
    heads += [element("th", column.heading, scope="col", data_order=_order(column.measure)) for column in columns]
    sizes = [_largest(c.measure, columns) for c in columns]
    best = [_best(column, size) for column, size in zip(columns, sizes, strict=True)]
    rows = [
        element(
            "tr",
            element("th", name, scope="row", class_=f"method c{styles[name].colour}"),
            [_cell(c, name, name in b, size) for c, b, size in zip(columns, best, sizes, strict=True)],
            class_="subject" if name == comparison.subject else None,
        )
        for name in methods
    ]
    hint = ""
    if measure is not None:
        parts = [
            unit(measure),
            "" if measure == SNR_GAIN else _BETTER[MEASURES[measure].direction] if measure in MEASURES else "",
        ]
        hint = ", ".join(part for part in parts if part)
    return element(
        "div",
        element(
            "table",
            element("caption", element("b", heading), element("small", hint) if hint else None),
            element("thead", element("tr", heads)),
            element("tbody", rows),
            class_="figures",
        ),
        class_=f"scroll {kind}".strip(),
        tabindex=0,
        role="region",
        aria_label=heading,
    )


def _cell(column: _Column, method: str, is_best: bool, largest: float) -> Html:
    figure = column.figures.get(method)
    if figure is None:
        return element("td", DASH)
    bounds = interval(figure, largest)
    value = number(figure.value, figure.measure, largest)
    return element(
        "td",
        element("b", value, element("span", " best", class_="hidden")) if is_best else value,
        element("small", bounds) if bounds else None,
        class_="best" if is_best else None,
        title=f"95 % interval {bounds}" if bounds else None,
        data_value=f"{_loss(figure):.6g}",
    )


def _loss(figure: Figure) -> float:
    """What a column is sorted by, the best first; gains by their size."""
    measure = MEASURES.get(figure.measure)
    return measure.loss(figure.value) if measure else -figure.value


def _order(measure: str) -> str:
    return MEASURES[measure].direction if measure in MEASURES else "higher"


def _largest(measure: str, columns: Sequence[_Column]) -> float:
    """The largest finite figure of a measure: its columns share a number of decimals."""
    figures = (f.value for column in columns if column.measure == measure for f in column.figures.values())
    return max((abs(value) for value in figures if math.isfinite(value)), default=0.0)


def _best(column: _Column, largest: float) -> set[str]:
    """Methods whose figure is the best of a column as it is printed; the optimum is a limit, and gains have no best."""
    if column.measure not in MEASURES:
        return set()
    measure = MEASURES[column.measure]
    found = {name: f for name, f in column.figures.items() if not math.isnan(f.value) and name != OPTIMUM}
    if not found:
        return set()
    first = min(found.values(), key=lambda f: measure.loss(f.value))
    shown = number(first.value, column.measure, largest)
    return {name for name, f in found.items() if number(f.value, column.measure, largest) == shown}
