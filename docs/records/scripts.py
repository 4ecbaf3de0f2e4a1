"""Scripts of this project as modules: they lie in no package."""

from __future__ import annotations

import importlib
import sys
from typing import Any

from records.record import ROOT


def script(folder: str, name: str) -> Any:
    """The script `name` of a folder, relative to the root, as a module; it finds scripts beside it."""
    sys.path.insert(0, str(ROOT / folder))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(ROOT / folder))
