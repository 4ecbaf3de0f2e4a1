"""What a stack is aimed at: the sampler that will look it up, and how much of what counts is what people see."""

from __future__ import annotations

import math
from typing import Literal, get_args

from mipbake.errors import UsageError, chosen

BakedSampler = Literal["trilinear", "anisotropic"]
"""`trilinear`: one lookup a pixel, at the level of the footprint's longer side. `anisotropic`: up to 16 lookups along
that side, at the level of the shorter one (mipbake.render.samplers)."""

BAKED_SAMPLERS: tuple[BakedSampler, ...] = get_args(BakedSampler)
"""Every sampler that stacks are made for, the default first."""

DEFAULT_SAMPLER: BakedSampler = "trilinear"
"""What real-time engines do unless they are told otherwise."""

DEFAULT_AIM = 0.5
"""From 0, SNR under single lights, to 1, what people see in moving pictures. A guess."""


def baked_sampler(name: str) -> BakedSampler:
    """The sampler of that name; UsageError, with the list of names, where stacks are made for none."""
    return chosen(name, BAKED_SAMPLERS, "sampler that stacks are made for")


def checked_aim(aim: float) -> float:
    """The aim; UsageError where it is no number from 0 to 1."""
    if not (math.isfinite(aim) and 0 <= aim <= 1):
        raise UsageError(f"the aim is {aim}: expected a number from 0 (single lights) to 1 (what people see)")
    return float(aim)
