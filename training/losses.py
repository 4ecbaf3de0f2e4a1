"""The losses that there are, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mipbake.training.balanced_loss import BalancedLossConfig
from mipbake.training.base import Loss
from mipbake.training.loss import SingleLightsLossConfig

LOSSES: Mapping[str, type[Loss[Any]]] = {kind.kind: kind for kind in (SingleLightsLossConfig, BalancedLossConfig)}
"""What configurations may name as `kind` in [loss]."""
