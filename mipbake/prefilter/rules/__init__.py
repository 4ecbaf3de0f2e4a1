"""Closed forms: one rule a file, and what they share."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.prefilter.base import Prefilter
from mipbake.prefilter.rules.filament import FILAMENT
from mipbake.prefilter.rules.godot import GODOT
from mipbake.prefilter.rules.lean import Lean
from mipbake.prefilter.rules.linear import Linear
from mipbake.prefilter.rules.toksvig import TOKSVIG
from mipbake.prefilter.rules.unreal import UNREAL
from mipbake.prefilter.rules.vmf import VMF

RULES: Mapping[str, Prefilter] = {m.name: m for m in (Lean(), TOKSVIG, VMF, GODOT, FILAMENT, UNREAL, Linear())}
"""Every closed form by its name."""
