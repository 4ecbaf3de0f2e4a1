"""How methods look, and curves of SNR over level of detail as inline SVG: every method is drawn, a few stand out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from mipbake.comparing.page.markup import Html, element
from mipbake.comparing.result import LINEAR, OPTIMUM, Comparison
from mipbake.quality.figures import SCALES, Figure
from mipbake.quality.metrics import PAIR_SETS
from mipbake.stack.written import SPOKEN

COLOURS = 9
"""How many colours the page's styles have for methods: `--c0` to `--c8`."""

WIDTH, HEIGHT = 490, 330
LEFT, RIGHT, TOP, BOTTOM = 38, 124, 30, 38  # margins of the axes; labels of lines stand to the right
_LABEL_GAP = 14


@dataclass(frozen=True)
class Look:
    """How a method is drawn.

    Args:
        colour: index of its colour: methods that differ only in their kernel share a colour.
        dashed: whether its lines are dashed: a method with the plain box has dashed lines.
        stands_out: whether it does so at first.
    """

    colour: int
    dashed: bool
    stands_out: bool


def looks(comparison: Comparison) -> Mapping[str, Look]:
    """The look of every method, in the order of `comparison.methods`."""
    shown = standing_out(comparison)
    others = [each for each in comparison.methods if each.name != comparison.subject]
    first = [each.method for name in (LINEAR, OPTIMUM) for each in others if each.name == name]
    families = list(dict.fromkeys(first + [each.method for each in others]))
    made = {}
    for each in comparison.methods:
        # The subject has a colour of its own, even where it was opened and its method is among the others.
        own = 0 if each.name == comparison.subject else 1 + families.index(each.method) % (COLOURS - 1)
        made[each.name] = Look(own, each.kernel == "box" and each.name != comparison.subject, each.name in shown)
    return made


def standing_out(comparison: Comparison) -> list[str]:
    """The subject, the closed form with the best mean SNR, `linear (box)` and the optimum, as far as they are there."""
    wanted = dict.fromkeys([comparison.subject, comparison.best_closed_form, LINEAR, OPTIMUM])
    names = {each.name for each in comparison.methods}
    return [name for name in wanted if name is not None and name in names]


@dataclass(frozen=True)
class _Axes:
    """Where figures fall in the drawing."""

    lods: tuple[float, float]
    decibels: tuple[float, float]

    def x(self, lod: float) -> float:
        low, high = self.lods
        return LEFT + (lod - low) / max(high - low, 1e-9) * (WIDTH - LEFT - RIGHT)

    def y(self, value: float) -> float:
        low, high = self.decibels
        return HEIGHT - BOTTOM - (value - low) / (high - low) * (HEIGHT - BOTTOM - TOP)


def curves(comparison: Comparison) -> Html:
    """A panel for each pair set and a legend for all; empty where no curve was measured."""
    views = [view for view in PAIR_SETS if any(point.view == view for point in comparison.curve)]
    if not views:
        return Html("")
    styles = looks(comparison)
    panels = [_panel(view, comparison, styles, index) for index, view in enumerate(views)]
    return element("div", element("div", panels, class_="panels"), _legend(styles), class_="curves", id="curves-figure")


def _panel(view: str, comparison: Comparison, styles: Mapping[str, Look], index: int) -> Html:
    lines = {}
    for name in styles:
        points = sorted((p for p in comparison.curve if p.view == view and p.method == name), key=lambda p: p.lod)
        if any(math.isfinite(p.value) for p in points):
            lines[name] = points
    drawn = [p for points in lines.values() for p in points]
    lods, values = [p.lod for p in drawn], [p.value for p in drawn if math.isfinite(p.value)]
    # A range of whole multiples of 5 dB around the figures.
    bottom, top = 5 * math.floor(min(values) / 5), 5 * math.ceil(max(values) / 5)
    axes = _Axes((min(lods), max(lods)), (bottom, max(top, bottom + 5)))
    # Thin lines first, the subject last, so that it lies on top.
    order = sorted(lines, key=lambda name: (styles[name].stands_out, name == comparison.subject))
    clip, place = f"plot-{index}", SPOKEN[view]
    label = f"SNR in decibels over level of detail {place}, a line for each method; the figures are in a table below"
    inside = element("rect", x=LEFT, y=TOP, width=WIDTH - LEFT - RIGHT, height=HEIGHT - TOP - BOTTOM)
    svg = element(
        "svg",
        element("defs", element("clipPath", inside, id=clip)),
        _grid(axes),
        element("g", [_band(lines[name], axes, name, styles[name]) for name in order], clip_path=f"url(#{clip})"),
        [_line(lines[name], axes, name, styles[name]) for name in order],
        _labels(lines, axes, styles),
        element("line", class_="cursor", x1=0, x2=0, y1=TOP, y2=HEIGHT - BOTTOM, hidden=True),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        aria_label=label,
        data_left=LEFT,
        data_right=RIGHT,
        data_lods=f"{axes.lods[0]:g} {axes.lods[1]:g}",
    )
    caption = element("figcaption", element("b", f"SNR {place}"), " in dB, higher is better")
    readout = element("div", class_="readout", hidden=True)
    return element("figure", caption, element("div", svg, readout, class_="plot"), class_="panel")


def _grid(axes: _Axes) -> Html:
    low, high = axes.decibels
    step = 5 if high - low <= 40 else 10
    parts: list[Html] = []
    for value in range(int(low), int(high) + 1, step):
        y = axes.y(value)
        parts.append(element("line", class_="grid", x1=LEFT, x2=WIDTH - RIGHT, y1=_n(y), y2=_n(y)))
        parts.append(element("text", value, class_="tick", x=LEFT - 7, y=_n(y + 4), text_anchor="end"))
    for lod in range(math.ceil(axes.lods[0]), math.floor(axes.lods[1]) + 1):
        x, y = _n(axes.x(lod)), HEIGHT - BOTTOM + 17
        parts.append(element("text", lod, class_="tick", x=x, y=y, text_anchor="middle"))
    for name, (first, last) in SCALES.items():
        parts.extend(_scale(name, first, last, axes))
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(element("text", "level of detail", class_="axis", x=_n(middle), y=HEIGHT - 4, text_anchor="middle"))
    return element("g", parts, aria_hidden="true")


def _scale(name: str, first: float, last: float, axes: _Axes) -> Iterable[Html]:
    """Where a scale lies: a line, or a band where it is a range; `far` of a short stack is its last level."""
    end = axes.lods[1]
    first, last = min(first, end), min(last, end)
    if last > first:
        left, right = axes.x(first), axes.x(last)
        yield element("rect", class_="range", x=_n(left), y=TOP, width=_n(right - left), height=HEIGHT - TOP - BOTTOM)
        yield element("text", name, class_="scale", x=_n(right), y=TOP - 8, text_anchor="middle")
        return
    x = axes.x(first)
    yield element("line", class_="scale-line", x1=_n(x), x2=_n(x), y1=TOP, y2=HEIGHT - BOTTOM)
    anchor = "start" if first <= axes.lods[0] else "middle"
    yield element("text", name, class_="scale", x=_n(x - 4 if anchor == "start" else x), y=TOP - 8, text_anchor=anchor)


def _runs(points: Sequence[Figure], *fields: str) -> list[list[Figure]]:
    """The points in runs whose named fields are finite: a gap breaks a line."""
    runs: list[list[Figure]] = [[]]
    for point in points:
        if all(math.isfinite(getattr(point, name)) for name in fields):
            runs[-1].append(point)
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def _band(points: Sequence[Figure], axes: _Axes, name: str, look: Look) -> Html:
    shapes = []
    for run in _runs(points, "low", "high"):
        edge = [(p.lod, p.high) for p in run] + [(p.lod, p.low) for p in reversed(run)]
        shapes.append(f"M{_path((axes.x(lod), axes.y(value)) for lod, value in edge)}Z")
    if not shapes:
        return Html("")
    return element("path", d="".join(shapes), class_=_classes("band", look), data_method=name)


def _line(points: Sequence[Figure], axes: _Axes, name: str, look: Look) -> Html:
    runs = ["M" + _path((axes.x(p.lod), axes.y(p.value)) for p in run) for run in _runs(points, "value")]
    figures = " ".join(f"{p.lod:g}:{p.value:.2f}" for p in points if math.isfinite(p.value))
    return element(
        "path",
        d="".join(runs),
        class_=_classes("line", look) + (" dashed" if look.dashed else ""),
        data_method=name,
        data_points=figures,
    )


def _labels(lines: Mapping[str, Sequence[Figure]], axes: _Axes, styles: Mapping[str, Look]) -> Html:
    """Names beside the ends of lines. Those that stand out lie a line apart, near the wanted heights and above the
    bottom; the name of a thin line is drawn, by scripts, when the line comes to stand out."""
    wanted = {name: axes.y(_runs(points, "value")[-1][-1].value) for name, points in lines.items()}
    shown = sorted((name for name in wanted if styles[name].stands_out), key=wanted.__getitem__)
    placed, above = dict(wanted), TOP - float(_LABEL_GAP)
    for name in shown:
        above = placed[name] = max(wanted[name], above + _LABEL_GAP)
    limit = float(HEIGHT - BOTTOM)
    for name in reversed(shown):
        placed[name] = min(placed[name], limit)
        limit = placed[name] - _LABEL_GAP
    labels = [
        element(
            "text",
            name if len(name) <= 18 else name[:17] + "…",
            class_=_classes("label", styles[name]),
            x=WIDTH - RIGHT + 7,
            y=_n(placed[name] + 4),
            data_method=name,
            data_y=_n(wanted[name] + 4),
        )
        for name in lines
    ]
    return element("g", labels, class_="labels", data_gap=_LABEL_GAP, data_top=TOP, data_bottom=HEIGHT - BOTTOM + 4)


def _legend(styles: Mapping[str, Look]) -> Html:
    """Every method with its colour and dash. The boxes work with scripts only, and are not shown without."""
    items = []
    for name, look in styles.items():
        line = element("line", x1=0, x2=26, y1=5, y2=5, class_=_classes("line", look) + " dashed" * look.dashed)
        swatch = element("svg", line, class_="swatch", viewBox="0 0 26 10", aria_hidden="true", data_method=name)
        box = element("input", type="checkbox", class_="js", checked=look.stands_out, data_method=name)
        items.append(element("label", box, swatch, element("span", name, class_="name"), class_="chip"))
    hint = element("legend", "Methods ", element("span", "to make stand out", class_="js"))
    return element("fieldset", hint, items, class_="legend")


def _classes(kind: str, look: Look) -> str:
    return f"{kind} c{look.colour}{' on' if look.stands_out else ''}"


def _path(points: Iterable[tuple[float, float]]) -> str:
    return "L".join(f"{_n(x)},{_n(y)}" for x, y in points)


def _n(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")
