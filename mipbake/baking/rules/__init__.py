"""Closed forms: one rule a file, and what they share."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.baking.prefilter import Prefilter
from mipbake.baking.rules.filament import FILAMENT
from mipbake.baking.rules.godot import GODOT
from mipbake.baking.rules.lean import Lean
from mipbake.baking.rules.linear import Linear
from mipbake.baking.rules.toksvig import TOKSVIG
from mipbake.baking.rules.unreal import UNREAL
from mipbake.baking.rules.vmf import VMF

RULES: Mapping[str, Prefilter] = {m.name: m for m in (Lean(), TOKSVIG, VMF, GODOT, FILAMENT, UNREAL, Linear())}
"""Every closed form by its name."""
