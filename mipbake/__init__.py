"""mipbake: bakes PBR texture sets into MIP stacks that keep their appearance at every scale, level 0 included."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from typing import TYPE_CHECKING, Any

# The build maps models/, training/, cli/ and the native core into this package. When Python runs from the root of
# a checkout, this folder shadows the installed package; extending the path finds those rooms there all the same.
__path__ = pkgutil.extend_path(__path__, __name__)

from mipbake.base.version import __version__ as __version__

if TYPE_CHECKING:
    from mipbake.baking import BakedDocument, BakedSet, BakeOptions, Listener, bake_all
    from mipbake.baking.bake import bake
    from mipbake.baking.convert import Material, convert, open_material
    from mipbake.base.errors import InputError, MipbakeError, OutputError, RendererError, UsageError
    from mipbake.comparing.validate import Validation, validate
    from mipbake.fitting import fit
    from mipbake.library import BatchListener, BatchOptions, bake_library, watch_library
    from mipbake.material.aim import Sampler
    from mipbake.source.loading import load, load_all
    from mipbake.source.texture_set import TextureSet
    from mipbake.stack.checking import Check
    from mipbake.stack.saving import open_stack
    from mipbake.stack.stack import MipStack

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

_HOMES = {
    "BakeOptions": "baking",
    "BakedDocument": "baking",
    "BakedSet": "baking",
    "BatchListener": "library",
    "BatchOptions": "library",
    "Check": "stack.checking",
    "InputError": "base.errors",
    "Listener": "baking",
    "Material": "baking.convert",
    "MipStack": "stack.stack",
    "MipbakeError": "base.errors",
    "OutputError": "base.errors",
    "RendererError": "base.errors",
    "Sampler": "material.aim",
    "TextureSet": "source.texture_set",
    "UsageError": "base.errors",
    "Validation": "comparing.validate",
    "bake": "baking.bake",
    "bake_all": "baking",
    "bake_library": "library",
    "convert": "baking.convert",
    "fit": "fitting",
    "load": "source.loading",
    "load_all": "source.loading",
    "open_material": "baking.convert",
    "open_stack": "stack.saving",
    "validate": "comparing.validate",
    "watch_library": "library",
}
"""Where each name comes from. Its module is imported when the name is first used: a command loads what it needs."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
