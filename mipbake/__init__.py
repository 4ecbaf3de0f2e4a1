"""mipbake: bakes PBR texture sets into MIP stacks that keep their appearance at every scale, level 0 included."""

from __future__ import annotations

import pkgutil
import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

# The build maps models/, training/, cli/ and the native core into this package. When Python runs from the root of
# a checkout, this folder shadows the installed package; extending the path finds those rooms there all the same.
__path__ = pkgutil.extend_path(__path__, __name__)

from mipbake._version import __version__ as __version__

if TYPE_CHECKING:
    from mipbake.aim import Sampler
    from mipbake.bake import bake
    from mipbake.baking import BakedDocument, BakedSet, BakeOptions, Listener, bake_all
    from mipbake.batch import BatchListener, BatchOptions, bake_library, watch_library
    from mipbake.compare.checking import Check
    from mipbake.convert import Material, convert, open_material
    from mipbake.errors import InputError, MipbakeError, OutputError, RendererError, UsageError
    from mipbake.fitting import fit
    from mipbake.loading import load, load_all
    from mipbake.stack import MipStack, open_stack
    from mipbake.texture_set import TextureSet
    from mipbake.validate import Validation, validate

__all__ = [
    "BakeOptions",
    "BakedDocument",
    "BakedSet",
    "BatchListener",
    "BatchOptions",
    "Check",
    "InputError",
    "Listener",
    "Material",
    "MipStack",
    "MipbakeError",
    "OutputError",
    "RendererError",
    "Sampler",
    "TextureSet",
    "UsageError",
    "Validation",
    "bake",
    "bake_all",
    "bake_library",
    "convert",
    "fit",
    "load",
    "load_all",
    "open_material",
    "open_stack",
    "validate",
    "watch_library",
]

_MODULES = {
    "aim": ("Sampler",),
    "bake": ("bake",),
    "baking": ("BakedDocument", "BakedSet", "BakeOptions", "Listener", "bake_all"),
    "batch": ("BatchListener", "BatchOptions", "bake_library", "watch_library"),
    "compare.checking": ("Check",),
    "convert": ("Material", "convert", "open_material"),
    "errors": ("InputError", "MipbakeError", "OutputError", "RendererError", "UsageError"),
    "fitting": ("fit",),
    "loading": ("load", "load_all"),
    "stack": ("MipStack", "open_stack"),
    "texture_set": ("TextureSet",),
    "validate": ("Validation", "validate"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}
"""Where each name comes from. Its module is imported when the name is first used: a command loads what it needs."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """Keeps the functions `bake`, `convert` and `validate` where they are offered.

    Python binds a module that is imported to its name in the package, and modules of these names hold the functions.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and _HOMES.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
