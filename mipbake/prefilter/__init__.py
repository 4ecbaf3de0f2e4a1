"""Prefilters: each turns the stored channels of level 0 into the stored channels of every level.

One interface (`Prefilter`): closed forms in `rules`, one a file; the network; methods that search, lists of stages in
`search`. METHODS is the list that the command line and the tests read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mipbake.errors import UsageError
from mipbake.prefilter.base import Prefilter, PrefilterResult
from mipbake.prefilter.neural import Neural
from mipbake.prefilter.rules import RULES
from mipbake.prefilter.search.methods import Auto, Optimum, Refine

METHODS: Mapping[str, Prefilter] = {m.name: m for m in (Auto(), Neural(), Refine(), Optimum())} | dict(RULES)

OPTIONS: Mapping[str, Mapping[str, Callable[..., Prefilter]]] = {
    "weights": {Auto.name: Auto, Neural.name: Neural, Refine.name: Refine},
    "budget": {Auto.name: Auto, Refine.name: Refine, Optimum.name: Optimum},
}
"""Option to the methods that have it, and what makes one with it from the option's keyword."""

__all__ = ["METHODS", "OPTIONS", "Prefilter", "PrefilterResult", "method_named"]


def method_named(name: str, weights: str | None = None, budget: str | None = None) -> Prefilter:
    """The method of that name, with what was chosen for it.

    Args:
        name: a key of METHODS.
        weights: trained weights by name, for methods that use some; None for the weights released as the default.
        budget: how long a method that optimises may take: `30s`, `2m`, any number of seconds or minutes, or `best`,
            until nothing improves any more; None for the default of the method.

    Raises:
        UsageError: an unknown name, with the list of names; an option that the method does not have; unknown weights; a
            budget that cannot be read.
    """
    if name not in METHODS:
        raise UsageError(f"unknown method {name!r}: expected one of {', '.join(METHODS)}")
    given = {option: value for option, value in (("weights", weights), ("budget", budget)) if value is not None}
    for option in given:
        if name not in OPTIONS[option]:
            raise UsageError(
                f"method {name} takes no {option}: leave it out, or choose one of {', '.join(OPTIONS[option])}"
            )
    return OPTIONS[next(iter(given))][name](**given) if given else METHODS[name]
