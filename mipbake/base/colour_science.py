"""The one door to colour-science, which takes most of a second to import and has to be told goodbye."""

from __future__ import annotations

import atexit
import sys
import warnings
from types import ModuleType

from mipbake.base.extras import extra


def colour_science(user: str) -> ModuleType:
    """The package `colour`; UsageError, which says what to type, where it is not installed.

    Args:
        user: what needs it, as the beginning of a sentence.
    """
    first = "colour" not in sys.modules
    with warnings.catch_warnings(), extra("compare", user):  # it warns of packages that plot or fit: none is used here
        warnings.simplefilter("ignore")
        import colour
    if first and "colour.io.image" in sys.modules:
        # It keeps objects of OpenImageIO until after that has gone, which then prints pages about leaks to stderr.
        atexit.register(vars(sys.modules["colour.io.image"]).clear)
    package: ModuleType = colour
    return package
