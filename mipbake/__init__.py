"""Bakes PBR texture sets into MIP stacks that keep their look from near and far, level 0 included.

A texture set is the maps of one material: base colour, normal, roughness, metallic and others. A stack has every level
of every map, ready for an engine.

    import mipbake

    stack = mipbake.bake("textures/wood", preset="unreal")   # a folder, a .zip, a .glb, or the files of one set
    stack.save("baked/wood")                                 # the files that this engine imports
    print(stack.verdict)                                     # how it looks beside plain MIP maps, in words
    stack.roughness                                          # the levels of a map: (H, W, 1) float32, finest first
    stack[2]["normal"]                                       # the maps of a level by name; len(stack) levels
    mipbake.validate("textures/wood", stack)                 # SNR in dB at several distances
    mipbake.compare("textures/wood").save("report")          # every method on one set: open report/index.html
    mipbake.bake_all(["scene.glb", "wood.zip"], "baked")     # as `mipbake bake` does, files measured
    mipbake.bake_library("textures", "baked")                # all that has changed below a folder, several processes

Where a texture set is expected, so is its path. `load` reads one set, `load_all` several, and
`TextureSet.from_arrays` takes arrays; `open_stack` reads a stack that was saved. What goes wrong is a `MipbakeError`:
a sentence that says what was expected. `help(mipbake.bake)` has the options.
"""

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
    from mipbake.comparing.comparison import compare
    from mipbake.comparing.result import Comparison
    from mipbake.comparing.validate import Validation, validate
    from mipbake.fitting import fit
    from mipbake.library import BatchListener, BatchOptions, bake_library, watch_library
    from mipbake.material.aim import Sampler
    from mipbake.source.loading import load, load_all
    from mipbake.source.texture_set import TextureSet
    from mipbake.stack.checking import Check
    from mipbake.stack.saving import open_stack
    from mipbake.stack.stack import MipStack

_HOMES = {
    "baking": ("BakeOptions", "BakedDocument", "BakedSet", "Listener", "bake_all"),
    "baking.bake": ("bake",),
    "baking.convert": ("Material", "convert", "open_material"),
    "base.errors": ("InputError", "MipbakeError", "OutputError", "RendererError", "UsageError"),
    "comparing.comparison": ("compare",),
    "comparing.result": ("Comparison",),
    "comparing.validate": ("Validation", "validate"),
    "fitting": ("fit",),
    "library": ("BatchListener", "BatchOptions", "bake_library", "watch_library"),
    "material.aim": ("Sampler",),
    "source.loading": ("load", "load_all"),
    "source.texture_set": ("TextureSet",),
    "stack.checking": ("Check",),
    "stack.saving": ("open_stack",),
    "stack.stack": ("MipStack",),
}
"""The names of each module. It is imported when one of them is first used: a command loads what it needs."""

__all__ = [
    "BakeOptions",
    "BakedDocument",
    "BakedSet",
    "BatchListener",
    "BatchOptions",
    "Check",
    "Comparison",
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
    "compare",
    "convert",
    "fit",
    "load",
    "load_all",
    "open_material",
    "open_stack",
    "validate",
    "watch_library",
]


def __getattr__(name: str) -> Any:
    home = next((home for home, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
