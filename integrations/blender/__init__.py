"""mipbake in Blender: bakes the images of a material, and shows them in its node tree."""

import bpy

from .operator import BakeMaterial
from .panel import MaterialPanel, Preferences, ShaderPanel
from .show import Baked

_CLASSES = (Preferences, Baked, BakeMaterial, ShaderPanel, MaterialPanel)


def register() -> None:
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Material.mipbake = bpy.props.PointerProperty(type=Baked)
    bpy.types.Scene.mipbake_folder = bpy.props.StringProperty(
        name="Folder",
        description="Where baked images go, each material in a folder of its own; // is the folder of the .blend file",
        subtype="DIR_PATH",
        default="//mipbake",
    )


def unregister() -> None:
    del bpy.types.Scene.mipbake_folder
    del bpy.types.Material.mipbake
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
