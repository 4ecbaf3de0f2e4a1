"""What was measured of a stack: where its levels came from, and how they measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

_SAME = 0.96
"""Share of the visible error of plain MIP maps above which a stack looks as they do: `Weights.seen_tie` as a share."""


@dataclass(frozen=True)
class Looks:
    """How a level looks in small pictures, by the renders that chose between methods: held-out ones have few pictures.

    Args:
        own, plain: visible errors (mipbake.quality.metrics.visible) of the stack and of plain MIP maps (the closed form
            linear, box), geometric means over slants. What nobody sees is in both.
        error: standard error of the logarithm of own / plain, which share their pictures.
        snr_gain: dB that the stack is above plain MIP maps under single lights, by pair set, in held-out renders. What
            shimmers in motion is hard to see in still pictures, and shows here.
    """

    own: float
    plain: float
    error: float
    snr_gain: Mapping[str, float]


@dataclass(frozen=True)
class MeasuredLevel:
    """A level of a stack, measured on renders that nothing was fitted to and that decided nothing. Figures are SNR in
    dB against the pixel-filtered reference, means over groups of 64 light-view pairs, by pair set
    (mipbake.quality.metrics.pairs.PAIR_SETS).

    Args:
        snr: of the stack. standard_error: of that.
        best_closed_form: name of the best closed form that may be blended, as other renders have it.
        best_closed_form_snr: its SNR.
        gain_error: standard error of the difference between the two, which share their points and pairs.
        level: 0 the finest.
        sources: methods whose levels take part in it; closed forms with their averaging kernel.
        refined: how much of what optimising its texels changed was kept, from 0 to 1.
        looks: how it looks; None in stacks of versions that did not measure it.
    """

    snr: Mapping[str, float]
    standard_error: Mapping[str, float]
    best_closed_form: Mapping[str, str]
    best_closed_form_snr: Mapping[str, float]
    gain_error: Mapping[str, float]
    level: int
    sources: tuple[str, ...]
    refined: float
    looks: Looks | None = None

    def gain(self, pair_set: str) -> float:
        """dB that the stack is above the best closed form there."""
        return self.snr[pair_set] - self.best_closed_form_snr[pair_set]


@dataclass(frozen=True)
class Measured:
    """How every level measured beside the best closed form.

    Levels that were found behind it by more than the measure is uncertain by gave way to the safest ingredient, as far
    as that helped; the figures say what remains.

    Args:
        levels: all of them.
        pairs: of each pair set that every level was measured with, at least. points: at most.
        visible: visible error (mipbake.quality.metrics.visible) of small pictures, as a share of what plain MIP maps
            have (the closed form linear, box), the geometric mean over levels of detail and slants; None in stacks of
            versions that did not measure it.
    """

    levels: tuple[MeasuredLevel, ...]
    pairs: int
    points: int
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
        """What the stack gains over the best closed forms: least, most, mean, and error."""
        gains = [each.gain(pair_set) for each in self.levels]
        error = max(each.gain_error[pair_set] for each in self.levels)
        middle = sum(gains) / len(gains)
        return (
            f"{min(gains):+.1f} to {max(gains):+.1f} dB, {middle:+.1f} in the mean (standard error {error:.1f} at most)"
        )

    def first(self, count: int) -> Measured:
        """The same for the first levels of the stack alone."""
        return replace(self, levels=self.levels[:count])


def measured_from(content: Any) -> Measured | None:
    """What JSON holds, where files call it "promise"; None for null. Errors of Python where it holds another thing."""
    if content is None:
        return None
    levels = [
        MeasuredLevel(
            **_figures(each),
            level=each["level"],
            sources=_names(each["sources"]),
            refined=each["refined"],
            looks=_looks(each.get("looks")),
        )
        for each in content["levels"]
    ]
    if not levels:
        raise ValueError("no level was measured")
    return Measured(
        tuple(levels),
        int(content["pairs"]),
        int(content["points"]),
        None if content.get("visible") is None else float(content["visible"]),
    )


def _figures(content: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of what was measured at one level of detail."""
    names = ("snr", "standard_error", "best_closed_form_snr", "gain_error")
    found: dict[str, dict[str, Any]] = {
        name: {str(pair_set): float(value) for pair_set, value in content[name].items()} for name in names
    }
    found["best_closed_form"] = {str(pair_set): str(name) for pair_set, name in content["best_closed_form"].items()}
    if len({frozenset(each) for each in found.values()}) > 1:
        raise ValueError("figures of one level have different pair sets")
    return found


def _looks(content: Any) -> Looks | None:
    if content is None:
        return None
    gain = {str(pair_set): float(value) for pair_set, value in content["snr_gain"].items()}
    own, plain = float(content["own"]), float(content["plain"])
    if not (own > 0 and plain > 0):
        raise ValueError(f"visible errors are {own} and {plain}: expected more than 0")
    return Looks(own, plain, float(content["error"]), gain)


def _names(content: Any) -> tuple[str, ...]:
    if not isinstance(content, list):
        raise ValueError(f"{content!r} is no list of names")
    return tuple(map(str, content))
