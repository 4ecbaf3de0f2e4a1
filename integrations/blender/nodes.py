"""Which images feed the Principled BSDF of a material. Reads node trees, and changes nothing."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

SOCKETS = {
    "base_color": "Base Color",
    "roughness": "Roughness",
    "metallic": "Metallic",
    "normal": "Normal",
    "opacity": "Alpha",
}
"""mipbake's name of a map, and the socket that it feeds."""

_CHANNELS = {"Red": "R", "Green": "G", "Blue": "B", "X": "R", "Y": "G", "Z": "B"}
_SEPARATE = ("ShaderNodeSeparateColor", "ShaderNodeSeparateXYZ")
_MATH = {"MULTIPLY": lambda a, b: a * b, "ADD": lambda a, b: a + b, "SUBTRACT": lambda a, b: a - b}


class BakeError(Exception):
    """What cannot be baked, and what to do: one sentence for the user."""


@dataclass(frozen=True)
class Use:
    """An image that feeds a socket of the Principled BSDF.

    Args:
        role: mipbake's name of the map. node: the image texture.
        channel: R, G, B or A; "" for colours.
        slope, offset: what the nodes behind the image make of its value x: slope * x + offset.
        strength: of the normal map. directx: whether its green points down.
        to: the input whose link changes when the baked image takes its place.
    """

    role: str
    node: bpy.types.Node
    to: bpy.types.NodeSocket
    channel: str = ""
    slope: float = 1.0
    offset: float = 0.0
    strength: float = 1.0
    directx: bool = False

    @property
    def image(self) -> bpy.types.Image:
        return self.node.image

    @property
    def as_it_is(self) -> bool:
        """Whether the file of the image says all."""
        return (self.slope, self.offset, self.strength) == (1.0, 0.0, 1.0)


@dataclass(frozen=True)
class Plan:
    """What is baked: an image for some roles, a number for the others."""

    uses: tuple[Use, ...]
    constants: dict[str, float]

    def key(self) -> list[Any]:
        """Equal for two plans of the same material, unless it has changed."""
        return [(u.role, u.node.name, u.image.name, u.channel, u.slope, u.offset, u.strength) for u in self.uses]


def plan_of(material: bpy.types.Material) -> Plan:
    """What is to be baked of a material. BakeError where that is not clear."""
    shaders = [node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled"]
    if len(shaders) != 1:
        raise BakeError(f"'{material.name}' has {len(shaders)} Principled BSDF nodes: exactly one can be baked")
    found = {role: _use(role, shaders[0].inputs[name]) for role, name in SOCKETS.items()}
    uses = tuple(use for use in found.values() if use)
    if not any(use.role != "opacity" for use in uses):
        raise BakeError(
            f"no image feeds the Principled BSDF of '{material.name}': "
            "link image textures to Base Color, Roughness, Metallic or Normal"
        )
    for use in uses:
        _check(use)
    if len({(use.node.extension, use.node.projection, origin(use.node.inputs["Vector"])) for use in uses}) > 1:
        raise BakeError(
            f"the images of '{material.name}' have different texture coordinates: give them one mapping and extension"
        )
    constants = {role: shaders[0].inputs[SOCKETS[role]].default_value for role in SOCKETS if not found[role]}
    return Plan(uses, {role: _number(value) for role, value in constants.items() if role not in ("normal", "opacity")})


def feeding(socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """The output that feeds an input, through reroutes; None without one."""
    while socket.is_linked:
        output = socket.links[0].from_socket
        if output.node.bl_idname != "NodeReroute":
            return output
        socket = output.node.inputs[0]
    return None


def origin(socket: bpy.types.NodeSocket) -> Any:
    """What an input gets, as nested tuples: equal for chains of nodes that do the same."""
    output = feeding(socket)
    if output is None:
        value = getattr(socket, "default_value", None)
        return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
    node = output.node
    kind = (node.bl_idname, output.identifier, getattr(node, "uv_map", ""), getattr(node, "vector_type", ""))
    return (*kind, *(origin(each) for each in node.inputs))


def _use(role: str, socket: bpy.types.NodeSocket) -> Use | None:
    """The image of a role, None without one."""
    found = list(_images(socket))
    output, name = feeding(socket), socket.name
    if output is None or (not found and role in ("base_color", "opacity")):
        return None  # what has no texels, as vertex colours, needs no levels
    if len(found) != 1:
        count = f"{len(found)} images" if found else "no image"
        raise BakeError(f"{name} comes from {count} through '{output.node.name}': bake that node to one image first")
    node, channel, to, passed = found[0]
    if role == "base_color" and to.type == "VALUE":
        return None  # a mask, or what a Color Ramp colours
    if role == "base_color" and channel:
        raise BakeError(f"{name} is one channel of '{node.name}': link the output Color of an image")
    if role in ("base_color", "opacity"):
        return Use(role, node, to, channel)  # averages do not mind what the nodes behind the image do
    if role == "normal":
        return _normal(node, channel, socket, passed)
    slope, offset = _line(passed, name)
    return Use(role, node, socket, channel, slope, offset)


def _images(
    socket: bpy.types.NodeSocket, passed: tuple[Any, ...] = ()
) -> Iterator[tuple[Any, str, Any, tuple[Any, ...]]]:
    """Images that feed an input: the node, its channel, the input that it feeds, and the inputs passed on the way."""
    output = feeding(socket)
    if output is None:
        return
    node = output.node
    if node.bl_idname == "ShaderNodeTexImage":
        yield node, "A" if output.identifier == "Alpha" else "", socket, passed
        return
    if node.bl_idname in _SEPARATE and getattr(node, "mode", "RGB") == "RGB":
        first = feeding(node.inputs[0])
        if first is not None and first.node.bl_idname == "ShaderNodeTexImage" and first.identifier == "Color":
            yield first.node, _CHANNELS[output.identifier], socket, passed
            return
    for each in node.inputs:
        yield from _images(each, (*passed, each))


def _normal(node: Any, channel: str, socket: bpy.types.NodeSocket, passed: tuple[Any, ...]) -> Use:
    between = passed[0].node if passed else node
    if len(passed) != 1 or between.bl_idname != "ShaderNodeNormalMap" or between.space != "TANGENT" or channel:
        raise BakeError(
            f"Normal passes through '{between.name}': link the image to a Normal Map node in tangent space, and that "
            "node to the shader"
        )
    if between.inputs["Strength"].is_linked:
        raise BakeError(f"the strength of '{between.name}' is linked: give it a number")
    directx = getattr(between, "convention", "OPENGL") == "DIRECTX"  # from 5.2 on
    return Use("normal", node, socket, strength=between.inputs["Strength"].default_value, directx=directx)


def _line(passed: tuple[Any, ...], name: str) -> tuple[float, float]:
    """Slope and offset of what the nodes between an image and a socket do."""

    def value(x: float) -> float:
        for socket in reversed(passed):  # from the image on
            x = _after(socket, x, name)
        return x

    return value(1.0) - value(0.0), value(0.0)


def _after(socket: bpy.types.NodeSocket, x: float, name: str) -> float:
    """What a node makes of the value of one of its inputs."""
    node = socket.node
    others = [each for each in node.inputs if each != socket and each.enabled]
    if not any(each.is_linked for each in others):
        if node.bl_idname == "ShaderNodeMath" and node.operation in _MATH:
            terms = [x if each == socket else each.default_value for each in node.inputs[:2]]
            return float(_MATH[node.operation](*terms))
        if node.bl_idname == "ShaderNodeInvert" and node.inputs[0].default_value == 1:
            return 1 - x
    raise BakeError(f"{name} passes through '{node.name}': link the image itself, or bake the nodes to an image first")


def _number(value: Any) -> float:
    """A constant: the mean of a colour."""
    mean = sum(list(value)[:3]) / 3 if hasattr(value, "__len__") else value
    return min(max(float(mean), 0.0), 1.0)


def _check(use: Use) -> None:
    """BakeError where the pixels of an image lie in no file, or are not what their socket expects."""
    image, node = use.image, use.node
    if image is None:
        raise BakeError(f"'{node.name}' has no image: open one")
    what = f"image '{image.name}'"
    if image.source not in ("FILE", "TILED") and not image.packed_file:
        kind = {"GENERATED": "is generated and lies in no file", "SEQUENCE": "is a sequence", "MOVIE": "is a movie"}
        raise BakeError(f"{what} {kind.get(image.source, 'lies in no file')}: save it as one image")
    if image.is_dirty:
        raise BakeError(f"{what} has changes that are not saved: save it")
    if image.source == "TILED":
        if image.packed_files or "<UDIM>" not in image.filepath:
            raise BakeError(f"{what} has tiles that are packed or not named by <UDIM>: unpack them")
        if not use.as_it_is:
            raise BakeError(f"{what} has tiles, and nodes behind it change its values: link it without them")
    missing = [path for path in files_of(image).values() if not path.is_file()]
    if missing:
        raise BakeError(f"{what}: {missing[0]} is not there: find or pack the image")
    space = image.colorspace_settings.name
    wanted = ("sRGB", "Linear Rec.709", "Non-Color") if use.role == "base_color" else ("Non-Color", "Linear Rec.709")
    if space not in wanted and use.channel != "A":
        raise BakeError(f"{what} feeds {SOCKETS[use.role]} in colour space {space}: expected {' or '.join(wanted[:2])}")


def files_of(image: bpy.types.Image) -> dict[int, Path]:
    """The files of an image by tile, 0 for one without tiles; none where it is packed."""
    if image.packed_file:
        return {}
    path = bpy.path.abspath(image.filepath, library=image.library)
    if image.source != "TILED":
        return {0: Path(path)}
    return {tile.number: Path(path.replace("<UDIM>", str(tile.number))) for tile in image.tiles}
