"""The layers of an OpenEXR file: which of its channels belong together, and which of them a role takes.

Channels are known by their names alone, and lie in the order of the alphabet. What stands before the last dot of a name
is the layer. A file may have several parts, with layers each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mipbake.base.errors import InputError
from mipbake.base.messages import listed, told_by
from mipbake.source.names import interpretations
from mipbake.source.sources import spoken

if TYPE_CHECKING:
    import OpenImageIO

_COLOURS = ("r g b", "red green blue", "x y z", "r g", "x y", "r", "red", "y")
"""Names of the channels of one image, in lower case, the most complete first."""

_ALPHA = ("a", "alpha")
_WHOLE = ("", "rgba", "rgb")
"""Names of layers that are the image itself."""


@dataclass(frozen=True)
class Layer:
    """Channels that make one image.

    Args:
        part: of the file, a number.
        name: of the layer; empty for channels without one.
        channels: their numbers in the part, in the order red, green, blue, alpha.
        alpha: which of these is alpha; -1: none.
        depth: type of the values.
    """

    part: int
    name: str
    channels: tuple[int, ...]
    alpha: int
    depth: str


def taken_layer(path: Path, image: OpenImageIO.ImageInput, role: str | tuple[int, str]) -> tuple[Layer, str]:
    """The layer for a role, or at a place (its part and name), and the names of the others, in a sentence's words.

    The reader stands at the layer's part afterwards. InputError where no layer is the role's, or can be read.
    """
    layers = []
    part = 0
    while image.seek_subimage(part, 0):
        layers += _layers(path, part, image.spec())
        part += 1
    told_by(image.geterror)  # clears what the end of the parts left
    layer = _chosen(path, layers, role)
    image.seek_subimage(layer.part, 0)
    if layer.depth.startswith("uint"):
        raise InputError(f"{path} stores numbers of objects, and no colours or values: choose another file")
    return layer, listed(each.name or "the one without a name" for each in layers if each != layer)


def _layers(path: Path, part: int, spec: OpenImageIO.ImageSpec) -> list[Layer]:
    if spec.deep:
        raise InputError(f"{path} is a deep image: expected one value for each texel, flatten it")
    several = int(spec.getattribute("oiio:subimages") or 1) > 1
    part_name = str(spec.getattribute("name") or "") if several else ""
    groups: dict[str, dict[str, int]] = {}
    for index, name in enumerate(spec.channelnames):
        layer, _, channel = name.rpartition(".")
        groups.setdefault(layer, {})[channel] = index
    found = []
    for layer, channels in groups.items():
        full = layer if layer.startswith(part_name) else f"{part_name}.{layer}".strip(".")
        for name, taken, alpha in _images(path, full, channels):
            types = {str(spec.channelformat(channel)) for channel in taken}
            found.append(Layer(part, name, taken, alpha, types.pop() if len(types) == 1 else "float"))
    return found


def _images(path: Path, layer: str, channels: dict[str, int]) -> list[tuple[str, tuple[int, ...], int]]:
    """The images in a layer, with name, channels and alpha: what its usual channels make, and each other channel."""
    lower = {name.lower(): index for name, index in channels.items()}
    if {"ry", "by"} & lower.keys():
        raise InputError(
            f"{path} stores brightness and differences of colours (Y, RY, BY): expected channels R, G and B; convert it"
        )
    usual = next((names for names in map(str.split, _COLOURS) if set(names) <= lower.keys()), [])
    alpha = [name for name in _ALPHA if name in lower][:1]
    rest = [name for name in channels if name.lower() not in (*usual, *alpha)]
    if not usual and len(rest) == 1:
        usual, rest = [rest[0].lower()], []  # the only channel of a layer may have any name
    found = []
    if usual or alpha:
        taken = tuple(lower[name] for name in (*usual, *alpha))
        found = [(layer, taken, len(usual) if usual and alpha else -1)]
    return found + [(f"{layer}.{name}".lstrip("."), (channels[name],), -1) for name in rest]


def _chosen(path: Path, layers: Sequence[Layer], role: str | tuple[int, str]) -> Layer:
    """The layer at a place; of a role the only layer, the one that is called after it, else the one without a name.

    InputError, which lists the layers, where none of these is there.
    """
    if not isinstance(role, str):
        return next(layer for layer in layers if (layer.part, layer.name) == role)
    if len(layers) == 1:
        return layers[0]
    named = [layer for layer in layers if role and role in _roles(layer.name)]
    whole = [layer for layer in layers if layer.name.lower() in _WHOLE]
    for several in (named, whole):
        if len(several) == 1:
            return several[0]
    found = listed(layer.name or "one without a name" for layer in layers)
    what = f"holds the {spoken(role)}" if role else "is the image"
    raise InputError(
        f"{path} has several layers ({found}), and {'more than one' if named else 'no'} name says that it {what}: "
        "export that layer as a file of its own"
    )


def _roles(name: str) -> set[str]:
    last = name.rpartition(".")[2]
    found = {meaning.role for each in {name, last} for match in interpretations(each) for meaning in match.meanings}
    return found | {name.lower(), last.lower()}
