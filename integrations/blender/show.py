"""Shows baked images in a material: new nodes beside the old ones, and links that are exchanged."""

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import bpy

from .nodes import BakeError, Plan, Use, feeding

MARK = "mipbake"
"""Custom property of the image nodes that show a baked map: its role."""

_FILE = re.compile(r"(_mip\d+\.png|\.exr)$")


class Baked(bpy.types.PropertyGroup):
    """What is baked of a material, and what of it is shown."""

    switches: bpy.props.StringProperty()  # JSON: inputs whose link differs, what feeds them before, what after
    levels: bpy.props.IntProperty()
    shown: bpy.props.EnumProperty(
        name="Show",
        items=[
            ("BEFORE", "Before", "Link the images as they were"),
            ("AFTER", "After", "Link the baked images"),
        ],
        default="AFTER",
        update=lambda self, _: link(self.id_data, self.shown),
    )
    one_level: bpy.props.BoolProperty(
        name="One Level",
        description="Show one level alone, for EEVEE and for Cycles before 5.2, which do not read levels of files",
        update=lambda self, context: _load(self.id_data, context),
    )
    level: bpy.props.IntProperty(
        name="Level",
        description="0 is the finest; each next one has texels twice as large, for surfaces twice as far away. The "
        "right one has texels as large as pixels",
        min=0,
        max=20,
        update=lambda self, context: _load(self.id_data, context),
    )


def link(material: bpy.types.Material, shown: str) -> None:
    """Links what is to be shown. Nodes that the user has removed are left out."""
    for to, before, after in _switches(material):
        target = _socket(material, "inputs", to)
        source = _socket(material, "outputs", before if shown == "BEFORE" else after)
        if target and source:
            material.node_tree.links.new(source, target)


def _load(material: bpy.types.Material, context: bpy.types.Context) -> None:
    """`load` for the panel, which has no reports: a file that is gone is told in a popup."""
    baked = material.mipbake
    if baked.level >= max(baked.levels, 1):
        baked.level = max(baked.levels, 1) - 1  # which comes here again
        return
    try:
        load(material)
    except BakeError as error:
        sentence = str(error)
        context.window_manager.popup_menu(
            lambda menu, _: menu.layout.label(text=sentence), title="mipbake", icon="ERROR"
        )


def load(material: bpy.types.Material) -> None:
    """Loads the files of the level that is to be shown into the baked image nodes."""
    baked = material.mipbake
    ending = f"_mip{baked.level:02}.png" if baked.one_level else ".exr"
    for node in baked_nodes(material):
        tiles = [tile.number for tile in node.image.tiles] if node.image.source == "TILED" else []
        node.image = _image(_FILE.sub(ending, node.image.filepath), node[MARK], tiles)


def remove(material: bpy.types.Material) -> None:
    """Leaves the tree as it was before it was baked."""
    link(material, "BEFORE")
    nodes = material.node_tree.nodes
    gone = {nodes.get(after[0]) for _, _, after in _switches(material)} | set(baked_nodes(material))
    for node in filter(None, gone):
        nodes.remove(node)
    material.mipbake.switches = ""


def rewire(material: bpy.types.Material, plan: Plan, folder: str) -> None:
    """Links the images that were baked into a folder, whose name their names begin with."""
    stem = f"{folder}/{Path(folder).name}"
    files = Path(bpy.path.abspath(folder)).glob("*_mip*.png")
    material.mipbake.levels = min(Counter(path.name.rpartition("_mip")[0] for path in files).values())
    bottom = min(_place(node)[1] for node in material.node_tree.nodes) - 320  # nodes of images are as high
    switches = []
    for row, use in enumerate(plan.uses):
        node = _successor(material, use, stem)
        node.location = (_place(use.node)[0], bottom - 60 * row)
        output = node.outputs["Color"]
        if use.role == "normal":
            output = _normal_map(material, use, node)
        switches.append([_name(each) for each in (use.to, use.to.links[0].from_socket, output)])
    material.mipbake.switches = json.dumps(switches)
    material.mipbake.shown = "AFTER"
    material.mipbake.level = min(material.mipbake.level, material.mipbake.levels - 1)
    load(material)


def _successor(material: bpy.types.Material, use: Use, stem: str) -> Any:
    """An image node with the baked image, looked up as the old one is."""
    tree, old = material.node_tree, use.node
    node = tree.nodes.new("ShaderNodeTexImage")
    node.label, node.hide, node[MARK] = f"mipbake {use.role}", True, use.role
    for name in ("interpolation", "extension", "projection", "projection_blend"):
        setattr(node, name, getattr(old, name))
    if old.inputs["Vector"].is_linked:
        tree.links.new(old.inputs["Vector"].links[0].from_socket, node.inputs["Vector"])
    tiles = [tile.number for tile in use.image.tiles] if use.image.source == "TILED" else []
    node.image = _image(f"{stem}_{use.role}{'.<UDIM>' if tiles else ''}.exr", use.role, tiles)
    return node


def _normal_map(material: bpy.types.Material, use: Use, node: Any) -> bpy.types.NodeSocket:
    made = material.node_tree.nodes.new("ShaderNodeNormalMap")
    made.label, made.hide = "mipbake normal", True
    made.uv_map = feeding(use.to).node.uv_map
    made.location = (node.location.x + 300, node.location.y)
    material.node_tree.links.new(node.outputs["Color"], made.inputs["Color"])
    return made.outputs["Normal"]


def _image(path: str, role: str, tiles: list[int]) -> bpy.types.Image:
    """The image of a file, read anew; colours of EXR files are linear, those of PNG files sRGB."""
    first = path.replace("<UDIM>", str(min(tiles))) if tiles else path
    known = [image for image in bpy.data.images if image.filepath == path]
    try:
        image = known[0] if known else bpy.data.images.load(bpy.path.abspath(first))
        if tiles and not known:
            image.source = "TILED"
            for tile in tiles:
                if image.tiles.get(tile) is None:
                    image.tiles.new(tile)
        image.filepath = path  # reads it
        colour = "Linear Rec.709" if path.endswith(".exr") else "sRGB"
        image.colorspace_settings.name = colour if role == "base_color" else "Non-Color"
    except (RuntimeError, TypeError) as error:  # what Blender raises for a missing file, and for an unknown space
        raise BakeError(f"{path} cannot be shown: {' '.join(str(error).split())}") from error
    return image


def _place(node: bpy.types.Node) -> tuple[float, float]:
    """Where a node lies in its tree, in frames or not."""
    x, y = node.location
    while (node := node.parent) is not None:
        x, y = x + node.location.x, y + node.location.y
    return x, y


def baked_nodes(material: bpy.types.Material) -> list[Any]:
    return [node for node in material.node_tree.nodes if MARK in node and node.image]


def _switches(material: bpy.types.Material) -> list[list[list[str]]]:
    return json.loads(material.mipbake.switches or "[]")


def _name(socket: bpy.types.NodeSocket) -> list[str]:
    return [socket.node.name, socket.identifier]


def _socket(material: bpy.types.Material, side: str, name: list[str]) -> Any:
    """The socket of a name, None where it is gone."""
    sockets = getattr(material.node_tree.nodes.get(name[0]), side, ())
    return next((each for each in sockets if each.identifier == name[1]), None)
