"""The panel, in the Shader Editor and beside the material; and the preferences."""

import bpy

from .operator import BakeMaterial, active


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="mipbake",
        description="The program that bakes, or its path",
        subtype="FILE_PATH",
        default="mipbake",
    )

    def draw(self, _context: bpy.types.Context) -> None:
        self.layout.prop(self, "command")


class _Panel:
    """What is in the panel, wherever it is."""

    bl_label = "mipbake"
    bl_region_type = "UI"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active(context) is not None

    def draw(self, context: bpy.types.Context) -> None:
        layout, material = self.layout, active(context)
        layout.operator(BakeMaterial.bl_idname, icon="RENDER_STILL")
        layout.prop(context.scene, "mipbake_folder")
        baked = material.mipbake
        if not baked.switches:
            return
        layout.row().prop(baked, "shown", expand=True)
        row = layout.row()
        row.active = baked.shown == "AFTER"
        row.prop(baked, "one_level")
        level = row.row()
        level.enabled = baked.one_level
        level.prop(baked, "level")


class ShaderPanel(_Panel, bpy.types.Panel):
    bl_idname = "MIPBAKE_PT_shader"
    bl_space_type = "NODE_EDITOR"
    bl_category = "mipbake"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        space = context.space_data
        return (space.tree_type, space.shader_type) == ("ShaderNodeTree", "OBJECT") and super().poll(context)


class MaterialPanel(_Panel, bpy.types.Panel):
    bl_idname = "MIPBAKE_PT_material"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "material"
