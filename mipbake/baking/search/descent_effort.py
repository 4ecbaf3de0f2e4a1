"""How much effort a descent makes: rounds, pairs and samples. How long it may take is a budget (time_budget.py)."""

from __future__ import annotations

from dataclasses import dataclass

from mipbake.base.errors import UsageError
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.metrics.pairs import PAIR_SETS

LOBES = 2
"""Lobes that half vectors of pixels are drawn from (pixel_samples.py). Not tuned: what is drawn from has so many."""

LOOKS = ProbeEffort(groups=16)  # groups of the renders that say whether rounds still help


@dataclass(frozen=True)
class DescentEffort:
    """How much effort a descent makes.

    Args:
        rounds: most rounds of a region. A round draws pixels, pairs and estimates of the reference anew.
        steps: Gauss-Newton steps of a round.
        pairs: light-view pairs of each pixel in a round, a multiple of 2 + LOBES: each has its own.
        samples: reference samples of a pixel of level 0; they double with every second level.
        looks: effort of the renders that say, after every few rounds, whether that still helps.
        window: regions of large sets are at most so many texels a side.

    """

    rounds: int = 40
    steps: int = 2
    pairs: int = 32
    samples: int = 8
    window: int = 512
    looks: ProbeEffort = LOOKS

    def __post_init__(self) -> None:
        least = {"rounds": 0, "steps": 1, "pairs": 4, "samples": 2, "window": 8}
        for name, low in least.items():
            value = getattr(self, name)
            if not isinstance(value, int) or value < low:
                raise UsageError(f"DescentEffort was given {name}={value!r}: expected a whole number from {low} up")
        if self.pairs % (len(PAIR_SETS) + LOBES):
            raise UsageError(
                f"DescentEffort was given pairs={self.pairs}: expected a multiple of {len(PAIR_SETS) + LOBES}"
            )
