"""Shows baked images in a material: new nodes beside the old ones, and links that are exchanged."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

from .nodes import BakeError, Plan, Use

MARK = "mipbake"
"""Custom property of the image nodes that show a baked map: its role."""

_FILE = re.compile(r"(_mip\d+\.png|\.exr)$")


class Switch(bpy.types.PropertyGroup):
    """An input whose link differs before and after: names of nodes, identifiers of their sockets."""

    node: bpy.props.StringProperty()
    socket: bpy.props.StringProperty()
    before_node: bpy.props.StringProperty()
    before_socket: bpy.props.StringProperty()
    after_node: bpy.props.StringProperty()
    after_socket: bpy.props.StringProperty()


class Baked(bpy.types.PropertyGroup):
    """What is baked of a material, and what of it is shown."""

    switches: bpy.props.CollectionProperty(type=Switch)
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
        update=lambda self, _: load(self.id_data),
    )
    level: bpy.props.IntProperty(
        name="Level",
        description="0 is the finest; each next one has texels twice as large, for surfaces twice as far away. The "
        "right one has texels as large as pixels",
        min=0,
        max=20,
        update=lambda self, _: load(self.id_data),
    )


def link(material: bpy.types.Material, shown: str) -> None:
    """Links what is to be shown. Nodes that the user has removed are left out."""
    tree = material.node_tree
    for each in material.mipbake.switches:
        to = _socket(tree, each.node, "inputs", each.socket)
        before = (each.before_node, each.before_socket)
        node, socket = before if shown == "BEFORE" else (each.after_node, each.after_socket)
        source = _socket(tree, node, "outputs", socket)
        if to and source:
            tree.links.new(source, to)


def load(material: bpy.types.Material) -> None:
    """Loads the files of the level that is to be shown into the baked image nodes."""
    baked = material.mipbake
    if baked.level >= max(baked.levels, 1):
        baked.level = max(baked.levels, 1) - 1  # which comes here again
        return
    ending = f"_mip{baked.level:02}.png" if baked.one_level else ".exr"
    for node in _baked_nodes(material):
        tiles = [tile.number for tile in node.image.tiles] if node.image.source == "TILED" else []
        node.image = _image(_FILE.sub(ending, node.image.filepath), node[MARK], tiles)


def remove(material: bpy.types.Material) -> None:
    """Leaves the tree as it was before it was baked."""
    link(material, "BEFORE")
    nodes = material.node_tree.nodes
    gone = {nodes.get(each.after_node) for each in material.mipbake.switches} | set(_baked_nodes(material))
    for node in [each for each in gone if each]:
        nodes.remove(node)
    material.mipbake.switches.clear()


def rewire(material: bpy.types.Material, plan: Plan, folder: str) -> None:
    """Links the images that were baked into a folder, whose name their names begin with."""
    stem = f"{folder}/{Path(folder).name}"
    levels = re.compile(re.escape(f"{Path(folder).name}_") + r".*_mip(\d+)\.png")
    found = [levels.fullmatch(path.name) for path in Path(bpy.path.abspath(folder)).iterdir()]
    material.mipbake.levels = 1 + max((int(match[1]) for match in found if match), default=0)
    nodes = material.node_tree.nodes
    bottom = min(_place(node)[1] for node in nodes) - 320  # below the highest of nodes
    for row, use in enumerate(plan.uses):
        node = _successor(material, use, stem)
        node.location = (_place(use.node)[0], bottom - 60 * row)
        output = node.outputs["Color"]
        if use.role == "normal":
            output = _normal_map(material, use, node)
        before, switch = use.to.links[0].from_socket, material.mipbake.switches.add()
        switch.node, switch.socket = use.to.node.name, use.to.identifier
        switch.before_node, switch.before_socket = before.node.name, before.identifier
        switch.after_node, switch.after_socket = output.node.name, output.identifier
    load(material)
    material.mipbake.shown = "AFTER"


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
    old = use.to.links[0].from_node
    made.label, made.hide = "mipbake normal", True
    made.uv_map = getattr(old, "uv_map", "")
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


def _baked_nodes(material: bpy.types.Material) -> list[Any]:
    return [node for node in material.node_tree.nodes if MARK in node and node.image]


def _socket(tree: bpy.types.NodeTree, node: str, side: str, identifier: str) -> Any:
    """The socket of that name, None where it is gone."""
    sockets: Iterator[Any] = iter(getattr(tree.nodes.get(node), side, ()))
    return next((each for each in sockets if each.identifier == identifier), None)
