"""What was measured of a stack: where its levels came from, and how they and lookups between them measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

_SAME = 0.96
"""Share of the visible error of plain MIP maps above which a stack looks as they do: `Weights.seen_tie` as a share."""


@dataclass(frozen=True)
class _Figures:
    """Measured on renders that nothing was fitted to and that decided nothing.

    Figures are SNR in dB against the pixel-filtered reference, means over groups of 64 light-view pairs, by pair set
    (mipbake.quality.metrics.pairs.PAIR_SETS).

    Args:
        snr: of the stack. standard_error: of that.
        best_closed_form: name of the best closed form, as other renders have it. best_closed_form_snr: its SNR.
        gain_error: standard error of the difference between the two, which share their points and pairs.
    """

    snr: Mapping[str, float]
    standard_error: Mapping[str, float]
    best_closed_form: Mapping[str, str]
    best_closed_form_snr: Mapping[str, float]
    gain_error: Mapping[str, float]

    def gain(self, pair_set: str) -> float:
        """dB that the stack is above the best closed form there."""
        return self.snr[pair_set] - self.best_closed_form_snr[pair_set]


@dataclass(frozen=True)
class MeasuredLevel(_Figures):
    """A level of a stack.

    Args:
        level: 0 the finest.
        sources: methods whose levels take part in it; closed forms with their averaging kernel.
        refined: how much of what optimising its texels changed was kept, from 0 to 1.
    """

    level: int
    sources: tuple[str, ...]
    refined: float


@dataclass(frozen=True)
class MeasuredBetween(_Figures):
    """A lookup halfway between two levels of a stack.

    Args:
        lod: level of detail.
    """

    lod: float


@dataclass(frozen=True)
class Measured:
    """How every level, and every lookup halfway between two, measured beside the best closed form.

    Levels that were found behind it by more than the measure is uncertain by gave way to the safest ingredient, as far
    as that helped; the figures say what remains.

    Args:
        levels: all of them.
        pairs: of each pair set that every level was measured with, at least. points: at most.
        left_out: closed forms that the budget left no time to measure: the best one may be among them.
        between: halfway between each level and the next; none in stacks of versions that did not measure there.
        visible: visible error (mipbake.quality.metrics.visible) of small pictures, as a share of what plain MIP maps
            have (the closed form linear, box), the geometric mean over levels of detail and slants; None in stacks of
            versions that did not measure it.
    """

    levels: tuple[MeasuredLevel, ...]
    pairs: int
    points: int
    left_out: tuple[str, ...] = ()
    between: tuple[MeasuredBetween, ...] = ()
    visible: float | None = None

    @property
    def looks_plain(self) -> bool:
        """Whether plain MIP maps look the same, for all that was measured."""
        return self.visible is not None and self.visible > _SAME

    def __repr__(self) -> str:
        """A description in one line."""
        figures = "; ".join(f"{name}: {self.summary(name)}" for name in self.levels[0].snr) if self.levels else "none"
        return f"Measured({len(self.levels)} levels, {figures})"

    def summary(self, pair_set: str) -> str:
        """What the stack gains over the best closed forms, at levels and between them: least, most, mean, and error."""
        every = [*self.levels, *self.between]
        gains = [each.gain(pair_set) for each in every]
        error = max(each.gain_error[pair_set] for each in every)
        middle = sum(gains) / len(gains)
        return (
            f"{min(gains):+.1f} to {max(gains):+.1f} dB, {middle:+.1f} in the mean (standard error {error:.1f} at most)"
        )

    def first(self, count: int) -> Measured:
        """The same for the first levels of the stack alone."""
        return replace(self, levels=self.levels[:count], between=self.between[: max(0, count - 1)])


def measured_from(content: object) -> Measured | None:
    """What JSON holds, where files call it "promise"; None for null. ValueError, with what was expected, else."""
    if content is None:
        return None
    if isinstance(content, dict):
        content = {"between": [], "visible": None, **content}
    whole = _checked("the promise", content, Measured)
    if not isinstance(whole["levels"], list) or not whole["levels"]:
        raise ValueError(f"levels of the promise is {_kind(whole['levels'])}: expected a list of levels")
    if not isinstance(whole["between"], list):
        raise ValueError(f"between of the promise is {_kind(whole['between'])}: expected a list of lookups")
    levels = [_figures(f"level {i} of the promise", each, MeasuredLevel) for i, each in enumerate(whole["levels"])]
    between = [_figures(f"lookup {i} of the promise", each, MeasuredBetween) for i, each in enumerate(whole["between"])]
    return Measured(
        tuple(MeasuredLevel(**{**each, "sources": tuple(each["sources"])}) for each in levels),
        whole["pairs"],
        whole["points"],
        tuple(whole["left_out"]),
        tuple(MeasuredBetween(**each) for each in between),
        whole["visible"],
    )


def _figures(what: str, content: object, kind: type) -> dict[str, Any]:
    """The fields of what was measured at one level of detail."""
    found = _checked(what, content, kind)
    if len({frozenset(found[name]) for name in _BY_SET}) > 1:
        raise ValueError(f"{what} has figures of different pair sets: expected the same in all")
    return found


_FIGURES = ("snr", "standard_error", "best_closed_form_snr", "gain_error")
_BY_SET = (*_FIGURES, "best_closed_form")


def _checked(what: str, content: object, kind: type) -> dict[str, Any]:
    """The fields of what was measured or a part of it. ValueError where one is missing, unknown or of another type."""
    if not isinstance(content, dict):
        raise ValueError(f"{what} is {_kind(content)}: expected an object")
    names = {field.name for field in fields(kind)}
    if set(content) != names:
        raise ValueError(f"{what} has {', '.join(sorted(map(str, content)))}: expected {', '.join(sorted(names))}")
    for name, value in content.items():
        expected = _expected_in(name, value)
        if expected:
            raise ValueError(f"{name} of {what} is {value!r}: expected {expected}")
    return content


def _expected_in(name: str, value: object) -> str | None:
    """What a field should hold; None where it does."""
    if name in ("level", "pairs", "points"):
        return None if _number(value) and isinstance(value, int) and value >= 0 else "a whole number from 0 up"
    if name == "visible":
        return None if value is None or _number(value) else "a number or null"
    if name in ("refined", "lod"):
        return None if _number(value) else "a number"
    if name in ("sources", "left_out"):
        fine = isinstance(value, list) and all(isinstance(each, str) for each in value)
        return None if fine else "a list of names"
    if name in _BY_SET:
        fine = isinstance(value, dict) and all(isinstance(key, str) for key in value)
        kind = str if name == "best_closed_form" else (int, float)
        fine = fine and all(isinstance(each, kind) and not isinstance(each, bool) for each in value.values())  # type: ignore[attr-defined]
        return None if fine else f"an object of pair sets with {'names' if kind is str else 'numbers'}"
    return None


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _kind(value: object) -> str:
    return f"a {type(value).__name__}"
