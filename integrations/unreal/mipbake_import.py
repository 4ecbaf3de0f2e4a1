"""Imports stacks that `mipbake bake SET --preset unreal` wrote: textures with their own levels, and a material.

In Unreal's Output Log choose Cmd and type, with the folder that mipbake wrote:

    py "D:/tools/mipbake_import.py" "D:/baked/wood" /Game/Materials
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import unreal

AGAIN = "bake the set again with mipbake bake SET --preset unreal"

# Map: its sampler in the material, its compression, and which channel feeds which input of the material.
MAPS: dict[str, tuple[str, str, dict[str, str]]] = {
    "base_color": ("COLOR", "TC_BC7", {"RGB": "MP_BASE_COLOR"}),
    "normal": ("NORMAL", "TC_NORMALMAP", {"RGB": "MP_NORMAL"}),
    "roughness": ("LINEAR_COLOR", "TC_BC7", {"R": "MP_AMBIENT_OCCLUSION", "G": "MP_ROUGHNESS", "B": "MP_METALLIC"}),
    "emissive": ("COLOR", "TC_BC7", {"RGB": "MP_EMISSIVE_COLOR"}),
    "height": ("LINEAR_COLOR", "TC_BC7", {}),
}


class ImportProblem(Exception):  # noqa: N818  it is said to users, not to programs
    """What is wrong, in a sentence."""


def import_folder(folder: str, destination: str = "/Game/mipbake") -> list[Any]:
    """Imports the stacks of a folder: one, or those of UDIM tiles.

    Args:
        folder: what mipbake wrote.
        destination: the content folder for the textures and the materials.

    Returns:
        The materials.

    Raises:
        ImportProblem: the folder holds no stack, or none for Unreal Engine, or a texture was not imported.
    """
    found = sorted(path for path in Path(folder).glob("stack*.json") if re.fullmatch(r"stack(\.1\d{3})?", path.stem))
    if not found:
        raise ImportProblem(f"{folder} holds no stack.json: name the folder that mipbake wrote, such as OUT/SET")
    if not destination.startswith("/"):
        raise ImportProblem(f"{destination} is no content folder: expected one such as /Game/Materials")
    stacks = [(path.parent, _read(path)) for path in found]
    return [_import(place, stack, destination.rstrip("/")) for place, stack in stacks]


def _read(manifest: Path) -> dict[str, Any]:
    """What a manifest says, once its files are known to be what Unreal Engine imports."""
    try:
        stack: dict[str, Any] = json.loads(manifest.read_text(encoding="utf-8"))
        outputs = [output for output in stack["outputs"] if output["format"] == "dds"]
        kinds = [(output["packing"], output["normal_convention"], "map_files" in output) for output in outputs]
        texels = {
            name: file["texels"] for output in outputs for file in output["maps"].values() for name in file["files"]
        }
    except (OSError, ValueError, KeyError, TypeError):
        raise ImportProblem(f"{manifest} cannot be read as the description of a stack: {AGAIN}") from None
    if kinds != [("orm", "DirectX", True)] or not {"rgba8", "rgba16f"}.issuperset(texels.values()):
        raise ImportProblem(f"{manifest} is not of files for Unreal Engine: {AGAIN}")
    for name in texels:
        if not (manifest.parent / name).is_file():
            raise ImportProblem(f"{manifest.parent / name} is missing: copy the whole folder that mipbake wrote")
    return {**stack, "texels": texels, "files": outputs[0]["map_files"]}


def _import(place: Path, stack: dict[str, Any], destination: str) -> Any:
    """Imports the textures, or imports them again, and makes the material where there is none."""
    textures = {name: _texture(place, stack, name, destination) for name in MAPS if name in stack["files"]}
    name = "M_" + re.sub(r"\W", "_", stack["name"])
    path = f"{destination}/{name}"
    assets = unreal.get_editor_subsystem(unreal.EditorAssetSubsystem)
    if assets.does_asset_exist(path):
        unreal.log(f"mipbake: updated the textures of {path}, the material itself is as it was")
        return unreal.load_asset(path)
    tools = unreal.AssetToolsHelpers.get_asset_tools()
    material = tools.create_asset(name, destination, unreal.Material, unreal.MaterialFactoryNew())
    if material is None:
        raise ImportProblem(f"Unreal Engine did not make {path}: the Output Log says why")
    _graph(material, stack, textures)
    assets.save_loaded_asset(material)
    unreal.log(f"mipbake: made {path}")
    return material


def _texture(place: Path, stack: dict[str, Any], name: str, destination: str) -> Any:
    """Imports the texture of a map, and keeps everything away from its levels."""
    file = stack["files"][name]
    task = unreal.AssetImportTask()
    task.set_editor_property("filename", str(place / file))
    task.set_editor_property("destination_path", destination)
    task.set_editor_property("automated", True)
    task.set_editor_property("replace_existing", True)
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    made = list(task.get_editor_property("imported_object_paths"))
    if not made:
        raise ImportProblem(f"Unreal Engine did not import {place / file}: the Output Log says why")
    texture = unreal.load_asset(str(made[0]))
    floats = stack["texels"][file] == "rgba16f"
    sampler, compression, _ = MAPS[name]
    address = {"wrap": unreal.TextureAddress.TA_WRAP, "clamp": unreal.TextureAddress.TA_CLAMP}
    settings = {
        "mip_gen_settings": unreal.TextureMipGenSettings.TMGS_LEAVE_EXISTING_MIPS,
        "composite_texture": None,  # it would widen roughness by bumps a second time
        "composite_texture_mode": unreal.CompositeTextureMode.CTM_DISABLED,
        "flip_green_channel": False,  # the files follow DirectX already
        "lod_bias": 0,
        "compression_settings": getattr(unreal.TextureCompressionSettings, "TC_HDR" if floats else compression),
        "srgb": sampler == "COLOR" and not floats,
        "address_x": address[stack["wrap"]["u"]],
        "address_y": address[stack["wrap"]["v"]],
    }
    for setting, value in settings.items():
        texture.set_editor_property(setting, value)
    unreal.get_editor_subsystem(unreal.EditorAssetSubsystem).save_loaded_asset(texture)
    return texture


def _graph(material: Any, stack: dict[str, Any], textures: dict[str, Any]) -> None:
    """One sampler for each texture, and what it feeds."""
    edit = unreal.MaterialEditingLibrary
    cutoff = stack["provenance"]["alpha_cutoff"]
    opacity = {}
    if "opacity" in stack["files"]:
        opacity = {"A": "MP_OPACITY" if cutoff is None else "MP_OPACITY_MASK"}
        blend = unreal.BlendMode.BLEND_TRANSLUCENT if cutoff is None else unreal.BlendMode.BLEND_MASKED
        material.set_editor_property("blend_mode", blend)
        if cutoff is not None:
            material.set_editor_property("opacity_mask_clip_value", cutoff)
    for row, (name, texture) in enumerate(textures.items()):
        sampler, _, feeds = MAPS[name]
        if not feeds:
            continue
        if sampler == "COLOR" and stack["texels"][stack["files"][name]] == "rgba16f":
            sampler = "LINEAR_COLOR"
        node = edit.create_material_expression(
            material, unreal.MaterialExpressionTextureSampleParameter2D, -400, 300 * row
        )
        node.set_editor_property("parameter_name", "ORM" if name == "roughness" else name.title().replace("_", ""))
        node.set_editor_property("texture", texture)
        node.set_editor_property("sampler_type", getattr(unreal.MaterialSamplerType, f"SAMPLERTYPE_{sampler}"))
        for channel, target in {**feeds, **(opacity if name == "base_color" else {})}.items():
            edit.connect_material_property(node, channel, getattr(unreal.MaterialProperty, target))
    edit.recompile_material(material)


if __name__ == "__main__":
    try:
        if not 2 <= len(sys.argv) <= 3:
            raise ImportProblem(
                'type py "mipbake_import.py" "OUT/SET" and, if you like, a folder such as /Game/Materials'
            )
        import_folder(*sys.argv[1:])
    except ImportProblem as problem:
        unreal.log_error(f"mipbake: {problem}.")
