"""Sources into files: what `mipbake bake` does, for Python."""

from __future__ import annotations

from mipbake.baking.options import BakeOptions
from mipbake.baking.results import BakedDocument, BakedSet, Listener, NotBaked, WrittenFile
from mipbake.baking.sources import bake_all, bake_sources

__all__ = [
    "BakeOptions",
    "BakedDocument",
    "BakedSet",
    "Listener",
    "NotBaked",
    "WrittenFile",
    "bake_all",
    "bake_sources",
]
