"""What a stack is aimed at: the sampler that will look it up, and how much of what counts is what people see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeVar, get_args

from mipbake.errors import UsageError

Name = TypeVar("Name", bound=str)

BakedSampler = Literal["trilinear", "anisotropic"]
"""`trilinear`: one lookup a pixel, at the level of the footprint's longer side. `anisotropic`: up to 16 lookups along
that side, at the level of the shorter one (mipbake.render.samplers)."""

BAKED_SAMPLERS: tuple[BakedSampler, ...] = get_args(BakedSampler)
"""Every sampler that stacks are made for, the default first."""

DEFAULT_SAMPLER: BakedSampler = "trilinear"
"""What real-time engines do unless they are told otherwise."""

DEFAULT_AIM = 0.5
"""From 0, SNR under single lights, to 1, what people see in moving pictures."""


def baked_sampler(name: str) -> BakedSampler:
    """The sampler of that name; UsageError, with the list of names, where stacks are made for none."""
    return sampler_among(name, BAKED_SAMPLERS, "sampler that stacks are made for")


def sampler_among(name: str, samplers: Sequence[Name], what: str) -> Name:
    """The one of some samplers that has that name; UsageError, which says what they are, where none has it."""
    for sampler in samplers:
        if sampler == name:
            return sampler
    *others, last = samplers
    raise UsageError(f"no {what} is called {name!r}: expected {', '.join(others)} or {last}")


def checked_aim(aim: float) -> float:
    """The aim; UsageError where it is no number from 0 to 1."""
    if not 0 <= aim <= 1:
        raise UsageError(f"the aim is {aim}: expected a number from 0 (single lights) to 1 (what people see)")
    return float(aim)
