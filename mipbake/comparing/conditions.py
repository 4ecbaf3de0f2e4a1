"""Conditions on the figures of a comparison, for build pipelines: `snr near-mirror lod=0 < 12` fails a build where it
holds.

    WORD ... [over METHOD] OP NUMBER

WORD   picks figures of `mipbake compare --json`: a value of `measure`, `view`, `scale` or `method`, or KEY=VALUE. Names
       with spaces stand in quotes. Together the words leave one figure. Without a method, it is the subject's; the
       method `best` is the closed form that is the best in this figure. With lod=NUMBER, it is a point of `curve`.
over   subtracts the figure of another method.
OP     <, <=, > or >=.

The figure itself decides, not its interval; one that is nan fails the build.
"""

from __future__ import annotations

import math
import operator
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mipbake.base.errors import UsageError
from mipbake.comparing.result import Comparison
from mipbake.quality.figures import Figure
from mipbake.quality.metrics import MEASURES, PAIR_SETS

EXAMPLE = "snr near-mirror lod=0 < 12"

GRAMMAR = (
    "WORD ... [over METHOD] OP NUMBER, where words are a measure, a view and a scale or lod=NUMBER, as --json names "
    "them, and a method, if it is not the subject; `best` is the best closed form; OP is <, <=, > or >=. Examples: "
    f"'{EXAMPLE}', 'snr hemisphere far over best < -1', 'film-floor jod-37 < 9'."
)
"""The grammar in one line, for help texts."""

BEST = "best"
"""Stands for the closed form that is the best in the figure."""

_KEYS = ("measure", "view", "scale", "lod", "method")
_OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Outcome:
    """What became of a condition.

    Args:
        failed: whether the build fails: the condition holds, or its figure is nan.
        value: the figure, or the difference of two.
        sentence: what to print.
    """

    failed: bool
    value: float
    sentence: str


@dataclass(frozen=True)
class Condition:
    """A condition that was read; `parse` makes it.

    Args:
        text: as it was given.
        words: that pick the figure, each with its key, or "" where the key is left out.
        other: whose figure is subtracted; None for nobody's.
        comparison, number: what the figure is compared with, and how.
    """

    text: str
    words: tuple[tuple[str, str], ...]
    other: str | None
    comparison: str
    number: float

    @property
    def values(self) -> frozenset[str]:
        """The words without their keys."""
        return frozenset(value for _, value in self.words)

    def check(self, found: Comparison) -> Outcome:
        """Whether the build fails, with the sentence that says why or why not.

        Before any work, a comparison with all that will be measured, as nan, tells whether this can be decided.

        Raises:
            UsageError: the words leave no figure, or several; the sentence says which figures there are.
        """
        figures = [each for each in (*found.figures, *found.curve) if each.measure in MEASURES]
        words: list[tuple[str, str]] = []
        for word in self.words:
            words.append(self._with_key(*word, figures, words))
        method = next((value for key, value in words if key == "method"), found.subject)
        picked = [word for word in words if word[0] != "method"]
        figure = self._figure(found, method, picked)
        less = None if self.other is None else self._figure(found, self.other, picked)
        value = figure.value - (less.value if less else 0.0)
        failed = math.isnan(value) or _OPERATORS[self.comparison](value, self.number)
        verb = "cannot be decided, which counts as failed" if math.isnan(value) else "holds"
        sentence = f"{self.text!r} {verb if failed else 'does not hold'}: {_described(figure, less, value)}"
        return Outcome(failed, value, sentence)

    def _with_key(
        self, key: str, value: str, figures: list[Figure], before: Sequence[tuple[str, str]]
    ) -> tuple[str, str]:
        """A word with its key; `before`: the words that stand before it, with theirs."""
        if value == BEST:
            return "method", value
        for each in (key,) if key else _KEYS:
            if value in _values(figures, each):
                return each, value
        fitting = [each for each in figures if all(_value(each, k) == v for k, v in before if v != BEST)]
        keys = (key,) if key else [each for each in _KEYS if each != "lod" and each not in dict(before)]
        expected = "; ".join(f"{each} {', '.join(_values(fitting, each))}" for each in keys)
        raise _wrong(self.text, f"there is no {key or 'figure'} {value!r}, expected {expected}")

    def _figure(self, found: Comparison, method: str, words: list[tuple[str, str]]) -> Figure:
        if method == BEST:
            rivals = [self._figure(found, name, words) for name in found.closed_forms]
            if not rivals:
                raise _wrong(self.text, f"no closed form is compared with the subject, expected one for {BEST!r}")
            return min(rivals, key=lambda figure: MEASURES[figure.measure].loss(figure.value))
        on_curve = any(key == "lod" for key, _ in words)
        left = [each for each in (found.curve if on_curve else found.figures) if each.measure in MEASURES]
        taken: list[str] = []
        for key, value in (("method", method), *words):
            kept = [each for each in left if _value(each, key) == value]
            if not kept:
                there = ", ".join(_values(left, key)) or "nothing"
                said = f"{' '.join(taken)} was not measured for {key} {value!r}, but for {there}"
                raise _wrong(self.text, said.strip())
            left, taken = kept, [*taken, value]
        for key in _KEYS if len(left) > 1 else ():
            if len(_values(left, key)) > 1:
                raise _wrong(self.text, f"it does not say which {key}, expected one of {', '.join(_values(left, key))}")
        return left[0]


def parse(text: str) -> Condition:
    """The condition that a text says; see the module for the grammar.

    Raises:
        UsageError: it says none; the sentence tells what is wrong, and shows an example.
    """
    whole = re.fullmatch(r"([^<>]*)([<>]=?)([^<>]*)", text)
    if whole is None:
        raise _wrong(text, "expected words, one of <, <=, > and >=, and a number")
    try:
        words = shlex.split(whole[1])
    except ValueError as error:
        raise _wrong(text, "a quotation has no end") from error
    try:
        number = float(whole[3])
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise _wrong(text, f"{whole[3].strip()!r} is not a number")
    other = None
    if "over" in words:
        at = words.index("over")
        words, other = words[:at], " ".join(words[at + 1 :])
    if not words or other == "":
        raise _wrong(text, "expected a method behind over" if words else "it does not say which figure")
    return Condition(text, tuple(_word(text, word) for word in words), other, whole[2], number)


def _word(text: str, word: str) -> tuple[str, str]:
    key, separator, value = word.partition("=")
    if not separator:
        return "", word
    if key not in _KEYS:
        raise _wrong(text, f"unknown key {key!r}, expected one of {', '.join(_KEYS)}")
    if key != "lod":
        return key, value
    try:
        return key, f"{float(value):g}"
    except ValueError:
        raise _wrong(text, f"the lod {value!r} is not a number") from None


def _value(figure: Figure, key: str) -> str:
    return f"{figure.lod:g}" if key == "lod" else str(getattr(figure, key))


def _values(figures: list[Figure], key: str) -> list[str]:
    """What figures have under a key, each once; of levels of detail, those of a curve."""
    found = [_value(each, key) for each in figures if key != "lod" or (not each.scale and each.view in PAIR_SETS)]
    return [*filter(None, dict.fromkeys(found))]


def _described(figure: Figure, less: Figure | None, value: float) -> str:
    measure = MEASURES[figure.measure]
    place = f", {figure.scale}" if figure.scale else f", lod {figure.lod:g}" if figure.view in PAIR_SETS else ""

    def said(each: Figure) -> str:
        interval = "" if math.isnan(each.low) else f" (95 % interval {each.low:.4g} to {each.high:.4g})"
        return f"{each.value:.6g} {measure.unit}".strip() + interval

    text = f"{measure.title} of {figure.method} ({figure.view}{place}) is {said(figure)}"
    if less is None:
        return text
    return f"{text}, and {less.method} has {said(less)}: the difference is {value:.6g}"


def _wrong(text: str, what: str) -> UsageError:
    return UsageError(f"condition {text!r}: {what}; for example {EXAMPLE!r}")
