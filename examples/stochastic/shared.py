"""What the scripts share: the modules of the fitting examples, and the settings of every script."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

sys.path.append(str(Path(__file__).resolve().parent.parent / "fitting"))

import report

Settings = TypeVar("Settings")


def parse(
    description: str, small: Settings, full: Settings | None, arguments: Sequence[str] | None
) -> tuple[Settings, Path]:
    """As `report.parse`, with results in the folder `stochastic` by default."""
    return report.parse(description, small, full, arguments, folder="stochastic")
