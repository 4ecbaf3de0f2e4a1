"""Prefilters: each turns the stored channels of level 0 into the stored channels of every level.

One file per method, one interface (`Prefilter`); METHODS is the list that the command line and the tests read.
"""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.errors import UsageError
from mipbake.prefilter.base import Prefilter, PrefilterResult
from mipbake.prefilter.filament import FILAMENT
from mipbake.prefilter.godot import GODOT
from mipbake.prefilter.lean import Lean
from mipbake.prefilter.linear import Linear
from mipbake.prefilter.neural import Neural
from mipbake.prefilter.optimum import Optimum
from mipbake.prefilter.toksvig import TOKSVIG
from mipbake.prefilter.unreal import UNREAL
from mipbake.prefilter.vmf import VMF

METHODS: Mapping[str, Prefilter] = {
    m.name: m for m in (Neural(), Optimum(), Lean(), TOKSVIG, VMF, GODOT, FILAMENT, UNREAL, Linear())
}

__all__ = ["METHODS", "Prefilter", "PrefilterResult", "method_named"]


def method_named(name: str) -> Prefilter:
    """The method of that name; UsageError with the list of names when there is none."""
    if name not in METHODS:
        raise UsageError(f"unknown method {name!r}: expected one of {', '.join(METHODS)}")
    return METHODS[name]
