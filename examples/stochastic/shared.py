"""What the scripts share: modules of the fitting examples, which are imported from here, and the command line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

sys.path.append(str(Path(__file__).resolve().parent.parent / "fitting"))

import camera
import meshes
import report
import textures

__all__ = ["camera", "meshes", "parse", "report", "textures"]

Settings = TypeVar("Settings")


def parse(
    description: str, small: Settings, full: Settings | None, arguments: Sequence[str] | None
) -> tuple[Settings, Path]:
    """As `report.parse`, with results in the folder `stochastic` by default."""
    return report.parse(description, small, full, arguments, folder="stochastic")
