"""Tables of a report: what one sees; then every measure by method and scale, the best marked, intervals below."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mipbake.comparing.films import FILM
from mipbake.comparing.page.charts import looks
from mipbake.comparing.page.markup import DASH, MINUS, SPACE, Content, Html, element, region
from mipbake.comparing.page.names import DISTANCES, called, distance
from mipbake.comparing.page.verdict import film_named, visible
from mipbake.comparing.result import LINEAR, OPTIMUM, Comparison
from mipbake.quality.figures import SCALES, SNR_GAIN, Figure
from mipbake.quality.metrics import MEASURES, PAIR_SETS
from mipbake.stack.written import SPOKEN

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


def title(measure: str, subject: str = "") -> str:
    """What a reader is shown as the name of a measure."""
    return f"SNR of {subject} above the SNR of each method" if measure == SNR_GAIN else MEASURES[measure].title


def unit(measure: str) -> str:
    """Unit of a measure; empty where it has none."""
    return "dB" if measure == SNR_GAIN else MEASURES[measure].unit


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
    elif unit(measure) == "JOD" or MEASURES[measure].direction == "one":
        text = f"{value:.2f}"
    else:
        size = max(abs(value if largest is None else largest), 1e-12)
        text = f"{value:.{min(max(2 - math.floor(math.log10(size)), 0), 4)}f}"
    return text.replace("-", MINUS)


# ---- what one sees


_SEEN = {
    "jod-37": (
        "Likeness to the truth",
        "10 looks the same, 0.1 more is hardly seen, 1 more is what three in four people prefer (JOD of ColorVideoVDP)",
    ),
    "flip": ("Difference from the truth", "0 looks the same, 1 is black in place of white (FLIP)"),
    "flicker": (
        "Shimmer",
        "1 changes from frame to frame as the truth does, 2 flickers twice as much, 0.5 is softer than the truth",
    ),
}


def seen_table(comparison: Comparison) -> Html:
    """Plain MIP maps beside the subject, near, at middle distance and far: of films, or without films of renders."""
    places = _places(comparison)
    names = list(dict.fromkeys((LINEAR, comparison.subject)))
    if not places:
        return Html("")
    measures = [measure for measure, *_ in places[0][2]]
    heads = [
        element(
            "th", element("b", _SEEN[each][0]), element("small", _SEEN[each][1]), scope="colgroup", colspan=len(names)
        )
        for each in measures
    ]
    rows = []
    for far, what, figures in places:
        cells = [_pair(comparison, names, at) for at in figures]
        head = element("th", element("b", far), element("small", what), scope="row")
        rows.append(element("tr", head, cells))
    said = [element("th", called(comparison, name), scope="col") for _ in measures for name in names]
    head = element("thead", element("tr", element("td"), heads), element("tr", element("td"), said))
    table = element("table", head, element("tbody", rows), class_="seen")
    return region("What one sees", table)


def _places(comparison: Comparison) -> list[tuple[str, str, Sequence[tuple[str, str, str]]]]:
    """Rows of the first table: the distance, what is looked at, and the measure, view and scale of its figures, the
    difference from the truth and shimmer."""
    judge = "jod-37" if any(f.measure == "jod-37" for f in comparison.figures) else "flip"
    scenes = sorted((each.scene for each in comparison.films), key=lambda scene: scene.lod)
    made = [
        (distance(s.lod), s.title.partition(",")[0], [(each, s.name, "") for each in (judge, "flicker")])
        for s in scenes
    ]
    if not made:
        for scale, said in DISTANCES.items():
            view = next((each.scene.view for each in comparison.rendered if each.scene.scale == scale), "")
            made.append((said, view, [("flip", view, scale), ("flicker", "near-mirror", scale)]))
    return [row for row in made if comparison.find(comparison.subject, *row[2][0])]


def _pair(comparison: Comparison, names: Sequence[str], at: tuple[str, str, str]) -> list[Html]:
    """A cell for each method, the better one marked; both where no difference is seen."""
    found = [comparison.find(name, *at) for name in names]
    losses = [MEASURES[at[0]].loss(each.value) if each else math.inf for each in found]
    said = [number(each.value, at[0]) if each else DASH for each in found]
    values = [each.value for each in found if each]
    least = visible(at[0], min(values), max(values)) if values and at[0] != "flicker" else 0.0
    wins = [
        each is not None and (abs(loss - min(losses)) < least or said[losses.index(min(losses))] == text)
        for each, loss, text in zip(found, losses, said, strict=True)
    ]
    return [element("td", text, class_="win" if win else None) for text, win in zip(said, wins, strict=True)]


# ---- every measure


def measure_tables(comparison: Comparison) -> Html:
    """A table for each measure and view with scales as columns; views without scales have measures as columns."""
    tables = []
    views = dict.fromkeys(figure.view for figure in comparison.figures)
    for view in [*(each for each in PAIR_SETS if each in views), *(each for each in views if each not in PAIR_SETS)]:
        here = [f for f in comparison.figures if f.view == view]
        place, measures = _place(view), [name for name in _ORDER if any(f.measure == name for f in here)]
        for measure in measures:
            columns = [_Column(scale, measure, _by_method(here, measure, scale)) for scale in SCALES]
            tables.append(_table(comparison, f"{title(measure, comparison.subject)} {place}", measure, columns))
        columns = [_Column(", ".join(filter(None, (title(m), unit(m)))), m, _by_method(here, m, "")) for m in measures]
        tables.append(_table(comparison, f"Every measure {place}", None, columns))
    return element("div", tables, class_="tables")


_ORDER = ("snr", SNR_GAIN, *(name for name in MEASURES if name != "snr"))


def curve_table(comparison: Comparison) -> Html:
    """The figures that the curves are drawn from, at whole levels of detail."""
    tables = []
    for view in PAIR_SETS:
        points = [p for p in comparison.curve if p.view == view and p.lod == int(p.lod)]
        lods = sorted({p.lod for p in points})
        columns = [_Column(f"{lod:g}", "snr", {p.method: p for p in points if p.lod == lod}) for lod in lods]
        tables.append(_table(comparison, f"SNR {SPOKEN[view]} by level of detail", "snr", columns, "scroll wide"))
    return element("div", tables)


def word_table(heads: Sequence[str], rows: Sequence[Sequence[Content]], label: str) -> Html:
    """A table of words; the first cell of a row is its heading."""
    made = [
        element("tr", element("th", row[0], scope="row"), [element("td", cell) for cell in row[1:]]) for row in rows
    ]
    head = element("thead", element("tr", [element("th", each, scope="col") for each in heads]))
    return region(label, element("table", head, element("tbody", made), class_="words"))


def _by_method(figures: Sequence[Figure], measure: str, scale: str) -> dict[str, Figure]:
    return {f.method: f for f in figures if f.measure == measure and f.scale == scale}


def _place(view: str) -> str:
    if view.startswith(FILM):
        return f"in the film of {film_named(view)}"
    return (SPOKEN | {"rotation": "in a slow rotation"}).get(view, f"on the {view}")


def _table(
    comparison: Comparison, heading: str, measure: str | None, columns: Sequence[_Column], kind: str = "scroll"
) -> Html:
    """Methods as rows; nothing without figures. Headings of columns are buttons that sort, where scripts run."""
    columns = [column for column in columns if column.figures]
    if not columns:
        return Html("")
    heads = [element("th", "Method", scope="col", class_="method")]
    heads += [element("th", c.heading, scope="col", data_order=_direction(c.measure)) for c in columns]
    sizes = {c.measure: _largest(c.measure, columns) for c in columns}
    best = [_best(column, sizes[column.measure]) for column in columns]
    rows = [
        element(
            "tr",
            element("th", name, scope="row", class_=f"method c{look.colour}"),
            [_cell(c, name, name in b, sizes[c.measure]) for c, b in zip(columns, best, strict=True)],
            class_="subject" if name == comparison.subject else None,
        )
        for name, look in looks(comparison).items()
        if any(name in column.figures for column in columns)
    ]
    hints = [] if measure is None else [unit(measure), "" if measure == SNR_GAIN else _BETTER[_direction(measure)]]
    hint = ", ".join(filter(None, hints))
    table = element(
        "table",
        element("caption", element("b", heading), element("small", hint) if hint else None),
        element("thead", element("tr", heads)),
        element("tbody", rows),
        class_="figures",
    )
    return region(heading, table, class_=kind)


def _cell(column: _Column, method: str, is_best: bool, largest: float) -> Html:
    figure = column.figures.get(method)
    if figure is None:
        return element("td", DASH)
    bounds = ""
    if not math.isnan(figure.low + figure.high):
        low, high = (number(bound, figure.measure, largest) for bound in (figure.low, figure.high))
        bounds = f"{low}{SPACE}to {high}"  # a narrow column breaks it once
    value = number(figure.value, figure.measure, largest)
    # What a column is sorted by, the best first; gains by their size.
    loss = -figure.value if figure.measure == SNR_GAIN else MEASURES[figure.measure].loss(figure.value)
    return element(
        "td",
        element("b", value, element("span", " best", class_="hidden")) if is_best else value,
        element("small", bounds) if bounds else None,
        class_="best" if is_best else None,
        title=f"95 % interval {bounds}" if bounds else None,
        data_value=f"{loss:.6g}",
    )


def _direction(measure: str) -> str:
    return "higher" if measure == SNR_GAIN else MEASURES[measure].direction


def _largest(measure: str, columns: Sequence[_Column]) -> float:
    """The largest finite figure of a measure: its columns share a number of decimals."""
    figures = (f.value for column in columns if column.measure == measure for f in column.figures.values())
    return max((abs(value) for value in figures if math.isfinite(value)), default=0.0)


def _best(column: _Column, largest: float) -> set[str]:
    """Methods whose figure is the best of a column as it is printed; the optimum is a limit, and gains have no best."""
    if column.measure == SNR_GAIN:
        return set()
    loss = MEASURES[column.measure].loss
    found = {name: f.value for name, f in column.figures.items() if not math.isnan(f.value) and name != OPTIMUM}
    shown = {name: number(value, column.measure, largest) for name, value in found.items()}
    first = min(found, key=lambda name: loss(found[name]), default=None)
    return {name for name, text in shown.items() if text == shown.get(first or "")}
