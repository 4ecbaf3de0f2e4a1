"""What a stack promises: level by level, where it came from, and how it measured beside the best closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class LevelPromise:
    """A level of a stack, measured on renders that it was not fitted to, but that also decided what was kept.

    Figures are SNR in dB against the pixel-filtered reference, means over groups of 64 light-view pairs, by pair set
    (mipbake.metrics.pairs.PAIR_SETS).

    Args:
        level: 0 the finest.
        sources: methods whose levels take part in it; closed forms with their averaging kernel.
        refined: how much of what optimising its texels changed was kept, from 0 to 1.
        snr: of the level. standard_error: of that.
        best_closed_form: name of the best one. best_closed_form_snr: its own.
        gain_error: standard error of the difference between the two, which share their points and pairs.
    """

    level: int
    sources: tuple[str, ...]
    refined: float
    snr: Mapping[str, float]
    standard_error: Mapping[str, float]
    best_closed_form: Mapping[str, str]
    best_closed_form_snr: Mapping[str, float]
    gain_error: Mapping[str, float]

    def gain(self, pair_set: str) -> float:
        """dB that the level is above the best closed form of it."""
        return self.snr[pair_set] - self.best_closed_form_snr[pair_set]


@dataclass(frozen=True)
class Promise:
    """How every level measured beside the best closed form.

    Levels that were found behind it by more than the measure is uncertain by gave way to the safest candidate, as far
    as that helped; the figures say what remains.

    Args:
        levels: all of them.
        pairs: of each pair set that every level was measured with, at least. points: at most.
    """

    levels: tuple[LevelPromise, ...]
    pairs: int
    points: int

    def summary(self, pair_set: str) -> str:
        """What the levels gain over the best closed forms, at least, at most and in the mean, and how sure that is."""
        gains = [each.gain(pair_set) for each in self.levels]
        error = max(each.gain_error[pair_set] for each in self.levels)
        middle = sum(gains) / len(gains)
        return (
            f"{min(gains):+.1f} to {max(gains):+.1f} dB, {middle:+.1f} in the mean (standard error {error:.1f} at most)"
        )


def promise_from(content: object) -> Promise | None:
    """A promise from what JSON holds; None for none. TypeError, KeyError or ValueError where it is no promise."""
    if content is None:
        return None
    if not isinstance(content, dict):
        raise TypeError(f"the promise is {type(content).__name__}")
    levels = tuple(LevelPromise(**{**each, "sources": tuple(each["sources"])}) for each in content["levels"])
    return Promise(**{**content, "levels": levels})
