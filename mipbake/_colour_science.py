"""The one door to colour-science, which takes most of a second to import and has to be told goodbye."""

from __future__ import annotations

import atexit
import sys
import warnings
from types import ModuleType


def colour_science() -> ModuleType:
    """The package `colour`."""
    first = "colour" not in sys.modules
    with warnings.catch_warnings():  # it warns of packages that plot or fit, which nothing here uses
        warnings.simplefilter("ignore")
        import colour
    if first and "colour.io.image" in sys.modules:
        # It keeps objects of OpenImageIO until after that has gone, which then prints pages about leaks to stderr.
        atexit.register(vars(sys.modules["colour.io.image"]).clear)
    package: ModuleType = colour
    return package
