"""How a report tells methods apart: which stand out, what colour and dash each has, in which order they come."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mipbake.comparing.ranking import LINEAR, OPTIMUM, best_closed_form
from mipbake.comparing.result import Comparison

REFERENCE = "reference"
"""What a report calls the reference beside the methods."""

COLOURS = 9
"""How many colours the page's styles have for methods: `--c0` to `--c8`."""


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
    best = best_closed_form(comparison)
    wanted = dict.fromkeys([comparison.subject, *([best] if best else []), LINEAR, OPTIMUM])
    names = {each.name for each in comparison.methods}
    return [name for name in wanted if name in names]
