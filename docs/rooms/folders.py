"""Where modules lie in a checkout, as pyproject.toml tells the build: the one place that says so."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent.parent


@cache
def folders() -> Mapping[str, str]:
    """Dotted names of packages to their folders, relative to ROOT. Of two that have a module, the later one counts."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages: Mapping[str, str] = settings["tool"]["scikit-build"]["wheel"]["packages"]
    return {name.replace("/", "."): folder for name, folder in packages.items()}
