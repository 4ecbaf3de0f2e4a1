"""Prefilters: each turns the stored channels of level 0 into the stored channels of every level.

One interface (`Prefilter`): closed forms in `rules`, one a file; the network; methods that search, lists of stages in
`search`. METHODS is the list that the command line and the tests read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mipbake.baking.neural import Neural
from mipbake.baking.prefilter import Prefilter, PrefilterResult
from mipbake.baking.rules import RULES
from mipbake.baking.search.checkpoint import discard, size_of
from mipbake.baking.search.long_run import LongRun, Stop
from mipbake.baking.search.methods import Auto, Optimum, Refine
from mipbake.base.errors import UsageError
from mipbake.base.names import known_name
from mipbake.material.aim import Sampler, sampler_of

METHODS: Mapping[str, Prefilter] = {m.name: m for m in (Auto(), Neural(), Refine(), Optimum())} | dict(RULES)

OPTIONS: Mapping[str, tuple[str, ...]] = {
    "weights": (Auto.name, Neural.name, Refine.name),
    "budget": (Auto.name, Refine.name, Optimum.name),
    "sampler": (Auto.name, Neural.name, Refine.name),
    "aim": (Auto.name, Refine.name),
    "device": (Auto.name, Neural.name, Refine.name),
}
"""Option to the methods that take it, as a keyword of what makes them."""

_MAKERS: Mapping[str, Callable[..., Prefilter]] = {each.name: each for each in (Auto, Neural, Refine, Optimum)}

__all__ = [
    "METHODS",
    "OPTIONS",
    "LongRun",
    "Prefilter",
    "PrefilterResult",
    "Stop",
    "discard",
    "method_named",
    "size_of",
]


def method_named(
    name: str,
    weights: str | None = None,
    budget: str | None = None,
    sampler: Sampler | str | None = None,
    aim: float | None = None,
    device: str | None = None,
    long_run: LongRun | None = None,
) -> Prefilter:
    """The method of that name, with what was chosen for it.

    Args:
        name: a key of METHODS.
        weights: trained weights by name, for methods that use some; None for the weights released as the default.
        budget: how long a method that optimises may take: `30s`, `2m`, any number of seconds, minutes or hours, or
            `best`, until nothing improves any more; None for the default of the method.
        sampler: of the engine that will look the stack up, by itself or by its name
            (`mipbake.material.aim.sampler_named`); None for the default one.
        aim: from 0, SNR under single lights, to 1, what people see in moving pictures; None for the default one.
        device: where a network runs: `cpu`, or `cuda` or `cuda:1` for a graphics card; None for `cpu`.
        long_run: who may stop a search that takes long, and where it is kept; other methods do without.

    Raises:
        UsageError: an unknown name, with the list of names; an option that the method does not take; unknown weights or
            an unknown sampler; a budget that cannot be read; an aim that is no number from 0 to 1; a device that cannot
            be used.
    """
    name = known_name("method", name, METHODS)
    options = {"weights": weights, "budget": budget, "sampler": sampler_of(sampler), "aim": aim, "device": device}
    given: dict[str, Any] = {option: value for option, value in options.items() if value is not None}
    for option in given:
        check_takes(name, option)
    if long_run is not None and name in OPTIONS["budget"]:
        given["long_run"] = long_run
    return _MAKERS[name](**given) if given else METHODS[name]


def check_takes(name: str, option: str, what: str | None = None) -> None:
    """UsageError where a method does not take an option; `what`: what the sentence calls it."""
    if name not in OPTIONS[option]:
        raise UsageError(
            f"method {name} takes no {what or option}: leave it out, or choose one of {', '.join(OPTIONS[option])}"
        )
