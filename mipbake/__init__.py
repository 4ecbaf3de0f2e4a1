"""mipbake: bakes PBR texture sets into MIP stacks that keep their appearance at every scale, level 0 included."""

from __future__ import annotations

import pkgutil

# The build maps models/, training/, cli/ and the native core into this package. When Python runs from the root of
# a checkout, this folder shadows the installed package; extending the path finds those rooms there all the same.
__path__ = pkgutil.extend_path(__path__, __name__)

# These modules import NumPy and nothing heavier: readers, colour science and torch are imported where they are used.
from mipbake._version import __version__ as __version__
from mipbake.bake import bake
from mipbake.baking import BakedDocument, BakedSet, BakeOptions, Listener, bake_all
from mipbake.compare.checking import Check
from mipbake.convert import Material, convert, open_material
from mipbake.errors import InputError, MipbakeError, OutputError, UsageError
from mipbake.loading import load, load_all
from mipbake.stack import MipStack, open_stack
from mipbake.texture_set import TextureSet
from mipbake.validate import Validation, validate

__all__ = [
    "BakeOptions",
    "BakedDocument",
    "BakedSet",
    "Check",
    "InputError",
    "Listener",
    "Material",
    "MipStack",
    "MipbakeError",
    "OutputError",
    "TextureSet",
    "UsageError",
    "Validation",
    "bake",
    "bake_all",
    "convert",
    "load",
    "load_all",
    "open_material",
    "open_stack",
    "validate",
]
