"""Conditions on the figures of a comparison, for build pipelines: `near_mirror@0 < 12` fails a build where it holds.

    [METHOD:]QUANTITY@WHERE [- METHOD] OP NUMBER

METHOD    what tables call it, `linear (box)`; `best` for the closed form that is the best in this quantity. Left out,
          the subject of the comparison. Behind a minus, its figure is subtracted: `near_mirror@0 - best < 1`.
QUANTITY  `near_mirror` or `hemisphere`, the SNR in dB on that set of light-view pairs; or a measure, `flip`. The
          measures that texture space has are meant there, near the mirror; the others on the render of the scale.
          Another view stands before it: `hemisphere.flicker`, `sphere.tonemapped`, `plane.flip`. Films are views, too:
          `film_floor.jod_37`, `film_wall.flip`, and `film_mesh` where a mesh was given.
WHERE     a scale, `near`, `1:1`, `middle` or `far`; of the SNR on a pair set also a level of detail of its curve, 0,
          0.25 and so on. A render that shows all scales has none: `plane.flip < 0.1`.
          So has a film: `film_floor.jod_37 < 9`.
OP        <, <=, > or >=.

Case does not matter, nor whether names are written with hyphens or underscores. The figure itself decides, not its
interval; one that is nan fails the build.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from mipbake.base.errors import UsageError
from mipbake.comparing.ranking import closed_forms
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import SCALES, Figure
from mipbake.quality.metrics import MEASURES, PAIR_SETS

GRAMMAR = (
    "[METHOD:]QUANTITY@WHERE [- METHOD] OP NUMBER. QUANTITY: near_mirror or hemisphere (SNR in dB), or "
    f"[VIEW.]MEASURE of {', '.join(MEASURES)}; WHERE: {', '.join(SCALES)}, or for SNR a level of detail; "
    "OP: <, <=, >, >=; METHOD: as tables call it, or best, the best closed form. "
    "Examples: 'near_mirror@0 < 12', 'flip@1:1 - best > 0', "
    "'linear (box):near_mirror@0.5 > 20', 'film_floor.jod_37 < 9'."
)
"""The grammar in one line, for help texts."""

EXAMPLE = "near_mirror@0 < 12"

BEST = "best"
"""Stands for the closed form that is the best in the quantity."""

IN_TEXTURE_SPACE = ("snr", "tonemapped", "flicker", "flicker-snr")
"""Measures that have figures for pair sets; without a view, those near the mirror are meant."""

_DEFAULT_VIEW = "near-mirror"
_OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_WHOLE = re.compile(
    r"(?:(?P<method>[^:@<>]*):)?(?P<quantity>[^:@<>]*)(?:@(?P<where>[^@<>]*))?(?P<op>[<>]=?)(?P<number>.*)", re.DOTALL
)
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_MINUS_AFTER_WHERE, _MINUS_ALONE = re.compile("-"), re.compile(r"\s-\s")  # names hold hyphens, places do not


@dataclass(frozen=True)
class Outcome:
    """What became of a condition.

    Args:
        text: the condition as it was given.
        failed: whether the build fails: the condition holds, or its figure is nan.
        value: the figure, or the difference of two.
        sentence: what to print.
    """

    text: str
    failed: bool
    value: float
    sentence: str


@dataclass(frozen=True)
class Condition:
    """A condition that was understood; `parse` makes it.

    Args:
        text: as it was given.
        method: whose figure; None for the subject.
        measure: a name in `mipbake.quality.metrics.MEASURES`.
        view: a pair set or the kind of a render; None for the render of the scale.
        where: a scale, a level of detail, or None for a render of all scales.
        other: whose figure is subtracted; None for nobody's.
        comparison, number: what the figure is compared with, and how.
    """

    text: str
    method: str | None
    measure: str
    view: str | None
    where: str | float | None
    other: str | None
    comparison: str
    number: float

    def check(self, found: Comparison) -> Outcome:
        """Whether the build fails, with the sentence that says why or why not.

        Before any work, a comparison with all that will be measured, as nan, tells whether this can be decided.

        Raises:
            UsageError: the comparison has no such figure; the sentence lists what it has.
        """
        figure = self._figure(found, self.method or found.subject)
        less = None if self.other is None else self._figure(found, self.other)
        value = figure.value - (less.value if less else 0.0)
        said = self._spoken(figure, less, value)
        if math.isnan(value):
            sentence = f"{self.text!r} cannot be decided, which counts as failed: {said}"
            return Outcome(self.text, True, value, sentence)
        failed = _OPERATORS[self.comparison](value, self.number)
        return Outcome(self.text, failed, value, f"{self.text!r} {'holds' if failed else 'does not hold'}: {said}")

    def _figure(self, found: Comparison, name: str) -> Figure:
        names = [method.name for method in found.methods]
        if _plain(name) != BEST:
            return self._of(found, self._named(name, names))
        rivals = [self._of(found, rival) for rival in closed_forms(found)]
        if not rivals:
            raise UsageError(
                f"condition {self.text!r}: no closed form is compared with the subject, expected one for {BEST!r}"
            )
        return min(rivals, key=lambda figure: MEASURES[self.measure].loss(figure.value))

    def _of(self, found: Comparison, name: str) -> Figure:
        """The figure of a method; UsageError with what there is in its place."""
        own = [
            figure
            for figure in (found.curve if isinstance(self.where, float) else found.figures)
            if (figure.method, figure.measure) == (name, self.measure)
        ]
        views = list(dict.fromkeys(figure.view for figure in own))
        view = self.view
        if view is None:
            of_scale = [f.view for f in own if f.scale == self.where and f.view not in PAIR_SETS]
            view = "sphere" if "sphere" in of_scale or not of_scale else of_scale[0]
        own = [figure for figure in own if figure.view == view]
        if not own:
            raise UsageError(
                f"condition {self.text!r}: {self.measure} of {name} was not measured for {view}, but for "
                f"{', '.join(views) or 'nothing'}"
            )
        if isinstance(self.where, float):
            for figure in own:
                if figure.lod == self.where:
                    return figure
            raise self._no_such_lod(self.where, [figure.lod for figure in own])
        for figure in own:
            if figure.scale == (self.where or ""):
                return figure
        scales = [figure.scale for figure in own if figure.scale]
        raise UsageError(
            f"condition {self.text!r}: {self.measure} for {view} was not measured "
            f"{f'at {self.where}' if self.where else 'without a scale'}, but "
            f"{'at ' + ', '.join(dict.fromkeys(scales)) if scales else 'over all scales at once: leave the place out'}"
        )

    def _named(self, name: str, names: Sequence[str]) -> str:
        for known in names:
            if _plain(known) == _plain(name):
                return known
        raise UsageError(
            f"condition {self.text!r}: no method {name!r} is compared, expected {BEST} or one of {', '.join(names)}"
        )

    def _no_such_lod(self, lod: float, lods: Iterable[float]) -> UsageError:
        return UsageError(
            f"condition {self.text!r}: no SNR is measured at lod {lod:g}, but at "
            f"{', '.join(f'{lod:g}' for lod in lods)}; or name a scale, {', '.join(SCALES)}"
        )

    def _spoken(self, figure: Figure, less: Figure | None, value: float) -> str:
        measure = MEASURES[self.measure]
        place = {str: f", {self.where}", float: f", lod {figure.lod:g}"}.get(type(self.where), "")

        def spoken(each: Figure) -> str:
            unit = f" {measure.unit}" if measure.unit else ""
            interval = "" if math.isnan(each.low) else f" (95 % interval {each.low:.4g} to {each.high:.4g})"
            return f"{each.value:.6g}{unit}{interval}"

        text = f"{measure.title} of {figure.method} ({figure.view}{place}) is {spoken(figure)}"
        if less is not None:
            text += f", and {less.method} has {spoken(less)}: the difference is {value:.6g}"
        return text


def parse(text: str) -> Condition:
    """The condition that a text says; see the module for the grammar.

    Raises:
        UsageError: it says none; the sentence tells what is wrong, at which character, and shows an example.
    """
    whole = _WHOLE.fullmatch(text)
    if whole is None:
        if not re.search("[<>]", text):
            raise _wrong(
                text, len(text.rstrip()), "nothing follows to compare with, expected <, <=, > or >= and a number"
            )
        raise _wrong(text, 0, "expected [METHOD:]QUANTITY@WHERE [- METHOD] OP NUMBER")
    head = "quantity" if whole["where"] is None else "where"
    minus = (_MINUS_ALONE if head == "quantity" else _MINUS_AFTER_WHERE).search(whole[head])
    other = None
    cut = len(whole[head])
    if minus:
        other, cut = whole[head][minus.end() :].strip(), minus.start()
        if not other:
            raise _wrong(text, whole.start(head) + minus.end(), "a method is missing behind the minus")
    method = whole["method"]
    if method is not None and not method.strip():
        raise _wrong(text, 0, "a method is missing before the colon")
    quantity = whole["quantity"][: cut if head == "quantity" else None]
    measure, view = _measured(text, whole.start("quantity"), quantity)
    if view is None and MEASURES[measure].needs == "film":
        known = f"film_floor.{measure.replace('-', '_')}"
        raise _wrong(text, whole.start("quantity"), f"it does not say of which film, expected it before, {known}")
    where: str | float | None = None
    if head == "where":
        where = _place(text, whole.start("where"), whole["where"][:cut], measure, view)
    elif view is None or view in PAIR_SETS:
        raise _wrong(text, whole.end("quantity"), f"it does not say where, expected @ and {', '.join(SCALES)} or a lod")
    number = whole["number"].strip()
    if not _NUMBER.fullmatch(number) or not math.isfinite(float(number)):
        raise _wrong(text, whole.start("number"), f"{number!r} is not a number")
    return Condition(
        text=text,
        method=method.strip() if method else None,
        measure=measure,
        view=view,
        where=where,
        other=other,
        comparison=whole["op"],
        number=float(number),
    )


def _measured(text: str, start: int, given: str) -> tuple[str, str | None]:
    """Measure and view of a quantity."""
    name = _plain(given)
    if name in PAIR_SETS:
        return "snr", name
    view, dot, measure = name.rpartition(".")
    if measure not in MEASURES or (dot and not view):
        known = ", ".join(each.replace("-", "_") for each in (*PAIR_SETS, *MEASURES))
        raise _wrong(text, start, f"{given.strip()!r} is not a quantity, expected one of {known}, or VIEW.MEASURE")
    if view in PAIR_SETS and measure not in IN_TEXTURE_SPACE:
        raise _wrong(text, start, f"{measure} is measured on renders, not for {view}")
    if not dot and measure in IN_TEXTURE_SPACE:
        return measure, _DEFAULT_VIEW
    return measure, view if dot else None


def _place(text: str, start: int, given: str, measure: str, view: str | None) -> str | float:
    name = given.strip().lower()
    if name in SCALES:
        return name
    if not _NUMBER.fullmatch(name) or not math.isfinite(float(name)):
        raise _wrong(
            text, start, f"{given.strip()!r} is not a place, expected {', '.join(SCALES)} or a level of detail"
        )
    if measure != "snr" or view not in PAIR_SETS:
        raise _wrong(text, start, f"{measure} has no curve over levels of detail, expected {', '.join(SCALES)}")
    return float(name)


def _plain(name: str) -> str:
    """Names as they are compared: case, spaces and underscores do not tell them apart."""
    return " ".join(name.lower().replace("_", "-").split())


def _wrong(text: str, start: int, what: str) -> UsageError:
    return UsageError(f"condition {text!r}, at character {start + 1}: {what}; for example {EXAMPLE!r}")
