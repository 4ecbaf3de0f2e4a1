"""The button Bake: runs mipbake beside Blender, and then changes the material in one step."""

import re
from pathlib import Path
from typing import Any

import bpy

from . import bake, show
from .nodes import BakeError, Plan, plan_of

_EVERY = 0.2  # seconds between two looks at a bake


class BakeMaterial(bpy.types.Operator):
    """Bake the images of this material, and show the result"""

    bl_idname = "material.mipbake"
    bl_label = "Bake"
    bl_options = {"UNDO"}  # noqa: RUF012  Blender reads it so

    running: Any = None
    """The bake that runs in this Blender."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        material = active(context)
        reasons = {
            "no material with nodes is active": material is None or material.node_tree is None,
            "the material is linked from another file": material is not None and material.library is not None,
            "a bake runs": cls.running is not None,
        }
        found = [reason for reason, holds in reasons.items() if holds]
        if found:
            cls.poll_message_set(found[0])
        return not found

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(_EVERY, window=context.window)
        manager.modal_handler_add(self)
        BakeMaterial.running = self._job
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if (event.type, event.value) == ("ESC", "PRESS"):
            self.cancel(context)
            self.report({"WARNING"}, "the bake was cancelled, nothing has changed")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._job.runs:
            context.workspace.status_text_set(self._job.status())
            return {"PASS_THROUGH"}
        self._leave(context)
        return self._finish(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._finish(context) if self._begin(context) else {"CANCELLED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Also where another file is opened meanwhile."""
        self._job.stop()
        self._leave(context)

    def _leave(self, context: bpy.types.Context) -> None:
        BakeMaterial.running = None
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        for area in context.screen.areas:
            area.tag_redraw()  # the button can be pressed again

    def _begin(self, context: bpy.types.Context) -> bool:
        material = active(context)
        try:
            self._material, self._folder = material.name, folder_of(context.scene)
            self._key = original_plan(material).key()
            command = context.preferences.addons[__package__].preferences.command
            folder, name = Path(bpy.path.abspath(self._folder)), safe(material.name)
            check_unused(folder / name, material)
            self._job = bake.start(original_plan(material), name, folder, command)
        except BakeError as error:
            self.report({"ERROR"}, str(error))
            return False
        return True

    def _finish(self, context: bpy.types.Context) -> set[str]:
        try:
            lines = self._job.lines()
            material = bpy.data.materials.get(self._material)
            if material is None or original_plan(material).key() != self._key:
                raise BakeError(f"'{self._material}' has changed while it was baked: bake it again")
            show.remove(material)
            show.rewire(material, plan_of(material), f"{self._folder}/{self._job.out.name}")
        except BakeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for line in (*lines, texture_cache(context.scene.render)):
            self.report({"WARNING" if line.startswith("warning") else "INFO"}, line)
        return {"FINISHED"}


def active(context: bpy.types.Context) -> bpy.types.Material | None:
    """The material that the editor shows, else that of the active object."""
    if getattr(context, "material", None):
        return context.material
    return context.object.active_material if context.object else None


def original_plan(material: bpy.types.Material) -> Plan:
    """The plan of a material as it was before it was baked."""
    show.link(material, "BEFORE")
    try:
        return plan_of(material)
    finally:
        show.link(material, material.mipbake.shown)


def folder_of(scene: bpy.types.Scene) -> str:
    """The folder of all baked materials, without a slash at its end."""
    folder = str(scene.mipbake_folder)
    if folder.startswith("//") and not bpy.data.filepath:
        raise BakeError(
            "the baked images go into the folder of the .blend file: save it first, or choose another Folder"
        )
    return folder[:2] + folder[2:].rstrip("/\\")


def check_unused(folder: Path, material: bpy.types.Material) -> None:
    """BakeError where another material shows what lies in a folder."""
    for other in bpy.data.materials:
        nodes = show.baked_nodes(other) if other != material and other.node_tree else []
        if any(Path(bpy.path.abspath(node.image.filepath)).parent == folder for node in nodes):
            raise BakeError(
                f"'{other.name}' shows the images in {folder}: rename '{material.name}', or choose another Folder"
            )


def safe(name: str) -> str:
    """The name of a material as a name of files."""
    return re.sub(r"[^\w-]+", "_", name).strip("_") or "material"


def texture_cache(render: bpy.types.RenderSettings) -> str:
    """Switches the texture cache on where there is one, and says what is read of the levels."""
    if not hasattr(render, "use_texture_cache"):
        return "Cycles before 5.2 reads level 0 alone, as EEVEE does: One Level shows another one"
    render.use_texture_cache, render.use_auto_generate_texture_cache = True, False
    return "Texture Cache is on and Auto Generate off, so Cycles reads the levels; EEVEE reads level 0, or One Level"
