"""Which of the compared methods are closed forms, and which of them is the one to beat."""

from __future__ import annotations

import math

from mipbake.baking.methods import METHODS
from mipbake.comparing.result import Comparison

LINEAR, OPTIMUM = "linear (box)", "optimum"
"""Names of what engines do today, and of the limit of what a stack can show."""


def closed_forms(comparison: Comparison) -> list[str]:
    """Names of the methods other than the subject that average and have no trained weights."""
    return [
        each.name
        for each in comparison.methods
        if each.name != comparison.subject and each.method in METHODS and METHODS[each.method].averages
    ]


def best_closed_form(comparison: Comparison) -> str | None:
    """The closed form whose SNR is the highest in the mean over scales and pair sets; None without figures."""
    means = {}
    for name in closed_forms(comparison):
        found = [f.value for f in comparison.figures if f.measure == "snr" and f.method == name and f.scale]
        if found and not any(math.isnan(value) for value in found):
            means[name] = sum(found) / len(found)
    return max(means, key=means.__getitem__, default=None)
