"""Searches that make little effort in many regions, for the tests of stopping and going on; and the command line with
one of them.

    python long_searches.py FLAG,... ARGUMENTS

A flag `slow` makes a round take a while, and `hangs` makes the end of a search hang.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from mipbake.baking.search import checkpoint, rounds, stages
from mipbake.baking.search.methods import Refine
from mipbake.baking.search.texel_descent import DescentEffort
from mipbake.base import progress
from mipbake.quality.judging.probes import ProbeEffort

progress.EVERY = 3600.0

FEW = ProbeEffort(groups=2, points=4, samples=2, pictures=8, picture_samples=2)
SOME_ROUNDS = DescentEffort(rounds=6, pairs=8, samples=2, window=16, coarse=8, looks=FEW)


class ManyRegions(Refine):
    """`refine` of a set of 16 x 32 texels: the coarse levels, one window of level 1, and two of level 0."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **{"effort": FEW, "descent": SOME_ROUNDS, **named})


def without_pauses(change: Callable[[object, str, Any], None] = setattr) -> None:
    """Checkpoints are written after every region."""
    change(checkpoint, "LEAST_SECONDS", 0.0)


def with_many_regions(change: Callable[[object, str, Any], None] = setattr) -> None:
    """Bakes by `refine` make this search."""
    module = importlib.import_module("mipbake.baking.pipeline")
    plain = module.method_named

    def named(name: str, *options: Any) -> Any:
        if name != "refine":
            return plain(name, *options)
        keywords = ("weights", "budget", "sampler", "aim", "device", "long_run")
        given = {key: each for key, each in zip(keywords, options, strict=True) if each is not None}
        return ManyRegions(**given)

    change(module, "method_named", named)


def _after(seconds: float, work: Callable[..., Any], *given: Any, **named: Any) -> Any:
    begin = time.monotonic()
    while time.monotonic() < begin + seconds:  # a signal that comes just before a sleep does not end that sleep
        time.sleep(0.02)
    return work(*given, **named)


if __name__ == "__main__":
    from mipbake.cli import main

    flags = sys.argv.pop(1).split(",")
    with_many_regions()
    without_pauses()
    if "slow" in flags:
        rounds.work = partial(_after, 0.2, rounds.work)
    if "hangs" in flags:
        stages.confirmed = partial(_after, 600.0, stages.confirmed)
    main.run()
