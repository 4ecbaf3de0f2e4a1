"""What a stack is aimed at: the sampler that will look it up, and how much of what counts is what people see."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from mipbake.base.errors import UsageError
from mipbake.base.names import unknown

LOOKUPS = (1, 2, 4, 8, 16)
"""How many lookups of a pixel a sampler may make at most."""

FRAMES = (1, 8)
"""How many frames an engine may average."""

MOST_BIAS = 4.0
"""Largest MIP bias, either way."""

_ACCUMULATED = "accumulated"
_ANISOTROPIC, _TIMES = "anisotropic", "anisotropic {}x"
_TRILINEAR = "trilinear"
_BIAS = "bias "


@dataclass(frozen=True)
class Sampler:
    """How an engine looks a stack up.

    A pixel's footprint has a longer and a shorter side, a >= b, in texels of level 0. It is looked up
    n = min(ceil(a / b), lookups) times, evenly spaced along the longer side, at the level of detail log2(a / n) + bias,
    clamped to the levels that exist. Lookups are averaged in stored channels and shaded once.

    Args:
        lookups: most lookups of a pixel, one of LOOKUPS. 1 is trilinear filtering, 16 what engines offer as 16x.
        bias: MIP bias: engines that average frames look finer levels up, and have a negative one.
        frames: 1, or 8: the mean of so many frames, each looked up and shaded at another point of the pixel, as engines
            accumulate them (`mipbake.quality.samplers.jitter`).

    Raises:
        UsageError: a number that is out of range.
    """

    lookups: int = 1
    bias: float = 0.0
    frames: int = 1

    def __post_init__(self) -> None:
        """Checks what may come from files."""
        for name, allowed in (("lookups", LOOKUPS), ("frames", FRAMES)):
            value = getattr(self, name)
            if isinstance(value, bool) or value not in allowed:
                raise UsageError(f"the sampler has {value!r} {name}: expected {_either(allowed)}")
        if isinstance(self.bias, bool) or not isinstance(self.bias, int | float) or not abs(self.bias) <= MOST_BIAS:
            raise UsageError(
                f"the sampler has the MIP bias {self.bias!r}: expected a number from {-MOST_BIAS:g} to {MOST_BIAS:g}"
            )
        for name, kind in (("lookups", int), ("bias", float), ("frames", int)):
            object.__setattr__(self, name, kind(getattr(self, name)))
        object.__setattr__(self, "bias", self.bias + 0.0)  # one zero

    def __str__(self) -> str:
        """What people call it: `trilinear`, `anisotropic 4x`, `accumulated, bias -1`; `sampler_named` reads it."""
        parts = [_ACCUMULATED] if self.frames > 1 else []
        if self.lookups > 1:
            parts.append(_ANISOTROPIC if self.lookups == LOOKUPS[-1] else _TIMES.format(self.lookups))
        if not parts:
            parts.append(_TRILINEAR)
        if self.bias:
            parts.append(_BIAS + repr(self.bias).removesuffix(".0"))
        return ", ".join(parts)


TRILINEAR = Sampler()
"""One lookup of a pixel."""

ANISOTROPIC = Sampler(lookups=LOOKUPS[-1])
"""What engines offer as 16x."""

SAMPLERS: Mapping[str, Sampler] = {
    _TRILINEAR: TRILINEAR,
    _ANISOTROPIC: ANISOTROPIC,
    _ACCUMULATED: Sampler(frames=FRAMES[-1]),
}
"""Samplers that have a name of their own, the default first."""

DEFAULT_SAMPLER = TRILINEAR
"""What real-time engines do unless they are set otherwise."""

DEFAULT_AIM = 0.5
"""From 0, SNR under single lights, to 1, what people see in moving pictures."""


def sampler_named(name: str) -> Sampler:
    """The sampler that is called so (`Sampler.__str__`), in any case; UsageError where none is."""
    lookups, bias, frames, name = 1, 0.0, 1, name.strip().lower()
    for part in name.split(", "):
        times = part.removeprefix(_ANISOTROPIC + " ").removesuffix("x")
        if part == _ACCUMULATED:
            frames = FRAMES[-1]
        elif part == _ANISOTROPIC:
            lookups = LOOKUPS[-1]
        elif part == _TIMES.format(times) and times.isdigit():
            lookups = int(times)
        elif part.startswith(_BIAS):
            bias = _number(part.removeprefix(_BIAS))
    # What a sampler is called has one form: whatever was read must be called so.
    if lookups in LOOKUPS and abs(bias) <= MOST_BIAS:
        found = Sampler(lookups, bias, frames)
        if str(found) == name:
            return found
    others = f", or one such as '{Sampler(lookups=4)}' or '{Sampler(bias=-1.0, frames=FRAMES[-1])}'"
    raise UsageError(unknown("sampler", name, SAMPLERS, others))


def sampler_of(sampler: Sampler | str | None, lod_bias: float | None = None) -> Sampler | None:
    """A sampler, by itself or by what it is called, with another MIP bias where one is given; None for neither."""
    if sampler is None and lod_bias is None:
        return None
    found = DEFAULT_SAMPLER if sampler is None else sampler_named(sampler) if isinstance(sampler, str) else sampler
    return found if lod_bias is None else replace(found, bias=lod_bias)


def sampler_from(content: object) -> Sampler:
    """A sampler from what JSON holds: a record, or the name that files of earlier versions have.

    ValueError, with what was expected, where it is none.
    """
    try:
        if isinstance(content, str):
            return sampler_named(content)
        names = [field.name for field in fields(Sampler)]
        if isinstance(content, dict) and sorted(content) == sorted(names):
            known: dict[str, Any] = content
            return Sampler(**known)
    except (UsageError, TypeError) as error:
        raise ValueError(str(error)) from error
    raise ValueError(f"the sampler is {content!r}: expected an object with {', '.join(names)}")


def checked_aim(aim: float) -> float:
    """The aim; UsageError where it is no number from 0 to 1."""
    if not 0 <= aim <= 1:
        raise UsageError(f"the aim is {aim}: expected a number from 0 (single lights) to 1 (what people see)")
    return float(aim)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _either(allowed: Any) -> str:
    *others, last = map(str, allowed)
    return f"{', '.join(others)} or {last}"
