"""What reaches an input of a MaterialX shader: channels of textures, scaled and shifted, or constants.

Node graphs are read symbolically: every channel of a signal is an affine function of one channel of a texture, or a
constant. What is neither is an UnreadError, which says why.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mipbake.source.mtlx.document import Document, Element, Link, Scope, UnreadError, Value

_USD = "UsdUVTexture"
_IMAGES = ("image", "tiledimage", "gltf_image", "gltf_colorimage", "gltf_normalmap", "gltf_anisotropy_image", _USD)

_MAX_DEPTH = 48
"""Nodes in a row that are followed: far more than there are between a texture and its shader."""

_ADDRESS = {"periodic": "wrap", "repeat": "wrap", "clamp": "clamp", "mirror": "mirror", "constant": "constant"}
_ADDRESS |= {"black": "constant"}
_PLACING = {"uvtiling": 1.0, "uvoffset": 0.0, "realworldimagesize": 1.0, "realworldtilesize": 1.0, "scale": 1.0}
_PLACING |= {"offset": 0.0, "rotate": 0.0, "uvindex": 0.0, "texcoord": 0.0, "st": 0.0, "frameoffset": 0.0}

_LETTERS = {"float": "R", "vector2": "RG", "color3": "RGB", "vector3": "RGB", "color4": "RGBA", "vector4": "RGBA"}
"""The channels of a file that an image node of a type gives."""

_POSITIONS = {letter: index for letters in ("rgba", "xyzw") for index, letter in enumerate(letters)}


@dataclass(frozen=True)
class Texture:
    """An image node's file.

    Args:
        path: the file, or a pattern of tiles.
        node: the image node's name and kind.
        type: the type of the node: "float", "color3", ...
        colour_space: as the document names it; None where it says nothing.
        inherited: whether that is said of something around the node only.
        wrap: addressing along u and v: "wrap", "clamp", "mirror" or "constant".
        placement: everything that moves the texture over the surface; equal for textures that lie on each other.
    """

    path: Path
    node: str
    type: str
    colour_space: str | None
    inherited: bool
    wrap: tuple[str, str]
    placement: tuple[Any, ...]


@dataclass(frozen=True)
class Channel:
    """gain * texture[letter] + offset; offset alone without a texture."""

    texture: Texture | None = None
    letter: str = ""
    gain: float = 0.0
    offset: float = 0.0


@dataclass(frozen=True)
class Signal:
    """Channels, and for tangent-space normals that a normalmap node has decoded its scale."""

    channels: tuple[Channel, ...]
    normal_scale: tuple[float, ...] | None = None

    @property
    def texture(self) -> Texture | None:
        """The one texture that all channels come from; None where there is none, or more than one."""
        several = {c.texture for c in self.channels}
        return several.pop() if len(several) == 1 else None

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """The values of a constant; None for anything else."""
        return None if any(c.texture for c in self.channels) else tuple(c.offset for c in self.channels)


@dataclass
class Tracer:
    """Follows the inputs of one document; every node is visited once."""

    document: Document
    _seen: dict[tuple[int, int, int, str], Signal | UnreadError] = field(default_factory=dict)
    _depth: int = 0

    def input(self, node: Element, name: str, scope: Scope) -> Signal | None:
        """What an input of a node holds; None where it is left at its default. UnreadError where it cannot be read."""
        given = self.document.given(node, name, scope)
        if isinstance(given, Link):
            return self._traced(given)
        if given is None:
            return None
        values = _numbers(given.text)
        if values is None:
            raise UnreadError(f"the value {given.text!r}")
        return _constant(*values)

    def _traced(self, link: Link) -> Signal:
        """What an output of a node holds."""
        source = self.document.source_of(link)
        node = source.node
        key = (id(node), id(source.scope.container), id(source.scope.instance), source.output)
        if key not in self._seen:
            if self._depth >= _MAX_DEPTH:
                raise UnreadError(f"more than {_MAX_DEPTH} nodes in a row")
            self._seen[key] = UnreadError(f"a loop through {node.get('name')}")  # for who comes here again meanwhile
            self._depth += 1
            try:
                at = _At(self, node, source.scope, source.output)
                self._seen[key] = _NODES.get(node.tag, _unknown)(at)
            except UnreadError as error:
                self._seen[key] = error
            self._depth -= 1
        signal = self._seen[key]
        if isinstance(signal, UnreadError):
            raise signal
        for letters in source.channels:
            signal = _taken(signal, letters)
        return signal


@dataclass(frozen=True)
class _At:
    """A node that is being read, for one of its outputs."""

    tracer: Tracer
    node: Element
    scope: Scope
    output: str

    def given(self, name: str, default: float = 0) -> Signal:
        signal = self.tracer.input(self.node, name, self.scope)
        return _constant(default) if signal is None else signal

    def text(self, name: str) -> str | None:
        given = self.tracer.document.given(self.node, name, self.scope)
        return given.text if isinstance(given, Value) else None

    @property
    def label(self) -> str:
        return f"the node {self.node.tag} ({self.node.get('name')})"

    def each(self, operation: Callable[[Channel, Channel], Channel], left: Signal, right: Signal) -> Signal:
        """An operation channel by channel; a single channel meets all of the other signal's."""
        if left.normal_scale or right.normal_scale:
            raise UnreadError(f"{self.label} on normals")
        count = max(len(left.channels), len(right.channels))
        a, b = (s.channels * count if len(s.channels) == 1 else s.channels for s in (left, right))
        if any(x.texture and y.texture for x, y in zip(a, b, strict=False)):
            raise UnreadError(f"{self.label} of two textures")
        return Signal(tuple(operation(x, y) for x, y in zip(a, b, strict=False)))


def _constant(*values: float) -> Signal:
    return Signal(tuple(Channel(offset=v) for v in values))


def _numbers(text: str) -> tuple[float, ...] | None:
    """The numbers that a value holds; None where it holds anything else, or a number that is not finite."""
    if text.strip() in ("true", "false"):
        return (float(text.strip() == "true"),)
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        return None
    return found if all(map(math.isfinite, found)) else None


def _picked(signal: Signal, index: int) -> Signal:
    if not 0 <= index < len(signal.channels):
        raise UnreadError(f"channel {index} of {len(signal.channels)}")
    return Signal((signal.channels[index],))


def _taken(signal: Signal, letters: str) -> Signal:
    """A swizzle: letters of rgba or xyzw, and 0 and 1 for constants."""
    if not letters:
        return signal
    values = dict(zip("01", _constant(0, 1).channels, strict=True))
    values |= {c: signal.channels[i] for c, i in _POSITIONS.items() if i < len(signal.channels)}
    if not set(letters) <= values.keys():
        raise UnreadError(f"the channels {letters}")
    return Signal(tuple(values[letter] for letter in letters))


# Of two channels, one at the most has a texture; a constant has no gain.
def _sum(sign: Callable[[float, float], float]) -> Callable[[Channel, Channel], Channel]:
    return lambda a, b: Channel(
        a.texture or b.texture, a.letter or b.letter, sign(a.gain, b.gain), sign(a.offset, b.offset)
    )


_plus, _minus = _sum(operator.add), _sum(operator.sub)


def _times(a: Channel, b: Channel) -> Channel:
    gain = a.gain * b.offset + a.offset * b.gain
    return Channel(a.texture or b.texture, a.letter or b.letter, gain, a.offset * b.offset)


def _unknown(at: _At) -> Signal:
    raise UnreadError(at.label)


def _extracted(at: _At) -> Signal:
    index = at.given("index").numbers
    return _picked(at.given("in"), int(index[0]) if index else -1)


def _converted(at: _At) -> Signal:
    """As many channels as the type has: one is repeated, a missing alpha is 1, others are cut off."""
    count, channels = len(_LETTERS.get(at.node.get("type", ""), "RGB")), at.given("in").channels
    return Signal((channels * count if len(channels) == 1 else (*channels, Channel(offset=1)))[:count])


def _combined(at: _At) -> Signal:
    parts = [at.given(f"in{i + 1}") for i in range(int(at.node.tag[-1]))]
    return Signal(tuple(channel for part in parts for channel in part.channels))


def _divided(at: _At) -> Signal:
    divisor = at.given("in2", 1).numbers
    if divisor is None or 0 in divisor:
        raise UnreadError(at.label)
    return at.each(_times, at.given("in1"), _constant(*(1 / d for d in divisor)))


def _mixed(at: _At) -> Signal:
    share = at.given("mix")
    back = at.each(_times, at.given("bg"), at.each(_minus, _constant(1), share))
    return at.each(_plus, at.each(_times, at.given("fg"), share), back)


def _clamped(at: _At) -> Signal:
    """Textures of [0, 1] stay in it, and what a factor drives out of it is clipped after decoding anyway."""
    low, high = at.given("low", 0).numbers or (), at.given("high", 1).numbers or ()
    return at.given("in") if (set(low), set(high)) == ({0}, {1}) else _unknown(at)


def _remapped(at: _At) -> Signal:
    ends = [at.given(n, d).numbers for n, d in (("inlow", 0), ("inhigh", 1), ("outlow", 0), ("outhigh", 1))]
    values = [e[0] for e in ends if e is not None and len(set(e)) == 1]
    if len(values) < len(ends) or values[0] == values[1] or at.given("gamma", 1).numbers != (1,):
        raise UnreadError(at.label)
    gain = (values[3] - values[2]) / (values[1] - values[0])
    return at.each(_plus, at.each(_times, at.given("in"), _constant(gain)), _constant(values[2] - gain * values[0]))


def _normal_map(at: _At) -> Signal:
    space, scale = at.text("space") or "tangent", at.given("scale", 1).numbers
    if space != "tangent":
        raise UnreadError(f"a normal map in {space} space ({at.node.get('name')})")
    if scale is None:
        raise UnreadError(f"a normal map whose scale is not a constant ({at.node.get('name')})")
    return replace(at.given("in"), normal_scale=scale)


def _image(at: _At) -> Signal:
    document, node = at.tracer.document, at.node
    file = document.given(node, "file", at.scope)
    if not isinstance(file, Value) or not file.text.strip():
        raise UnreadError(f"an image node without a file ({node.get('name')})")
    kind = {"gltf_normalmap": "vector3", "gltf_anisotropy_image": "vector3"}.get(node.tag, node.get("type", ""))
    kind = kind if kind in _LETTERS else "color4"  # a node of several outputs
    space = document.attribute("colorspace", file.element)
    if space is None or space[1] is not file.element:
        space = document.attribute("colorspace", node) or space
    if (named := at.text("sourceColorSpace")) not in (None, "auto"):
        space = (str(named), node)
    texture = Texture(
        document.file_of(file),
        f"{node.get('name')} ({node.tag})",
        kind,
        space[0] if space else None,
        space is not None and space[1] not in (node, file.element),
        (_address(at, "uaddressmode", "wrapS"), _address(at, "vaddressmode", "wrapT")),
        _placement(document, node, at.scope, 0),
    )
    signal = Signal(tuple(Channel(texture, letter, 1) for letter in _LETTERS[kind]))
    gains = {"gltf_image": "factor", "gltf_colorimage": "color", _USD: "scale"}.get(node.tag)
    if gains:
        signal = at.each(_times, signal, at.given(gains, 1))
    if node.tag == _USD:
        signal = at.each(_plus, signal, at.given("bias", 0))
    if node.tag == "gltf_normalmap":
        return replace(signal, normal_scale=(1.0,))
    if node.tag == "gltf_anisotropy_image":
        return _picked(signal, 2)
    letter = at.output.removeprefix("out").lower()
    if letter in _POSITIONS:
        return _picked(signal, _POSITIONS[letter])
    return Signal(signal.channels[:3]) if letter in ("color", "rgb") else signal


def _address(at: _At, *names: str) -> str:
    texts = [text for name in names if (text := at.text(name)) is not None]
    return _ADDRESS.get(texts[0], "wrap") if texts else "wrap"


def _placement(document: Document, node: Element, scope: Scope, depth: int) -> tuple[Any, ...]:
    """Inputs that place a texture on the surface and are not at their defaults."""
    placed: list[tuple[Any, ...]] = []
    for entry in node:
        name = entry.get("name", "")
        places = depth or (name in _PLACING and not (node.tag == _USD and name == "scale"))
        if entry.tag != "input" or not places or depth > 16:
            continue
        try:
            given = document.given(node, name, scope)
            source = document.source_of(given) if isinstance(given, Link) else given
        except UnreadError:  # as if it were not there
            continue
        if isinstance(source, Value):
            values = _numbers(source.text)
            if values is None or any(v != _PLACING.get(name, 0.0) for v in values):
                placed.append((name, values or source.text))
        elif isinstance(source, Link):
            inner = _placement(document, source.node, source.scope, depth + 1)
            if inner or source.node.tag not in ("texcoord", "place2d"):
                placed.append((name, source.node.tag, inner))
    return tuple(sorted(placed, key=repr))


_NODES: Mapping[str, Callable[[_At], Signal]] = {
    **dict.fromkeys(_IMAGES, _image),
    **dict.fromkeys(("dot", "normalize"), lambda at: at.given("in")),
    **dict.fromkeys(
        ("separate2", "separate3", "separate4"),
        lambda at: _picked(at.given("in"), _POSITIONS.get(at.output[-1:].lower(), -1)),
    ),
    **dict.fromkeys(("combine2", "combine3", "combine4"), _combined),
    **dict.fromkeys(("remap", "range"), _remapped),
    "constant": lambda at: at.given("value"),
    "normalmap": _normal_map,
    "convert": _converted,
    "swizzle": lambda at: _taken(at.given("in"), at.text("channels") or ""),
    "extract": _extracted,
    "invert": lambda at: at.each(_minus, at.given("amount", 1), at.given("in")),
    "add": lambda at: at.each(_plus, at.given("in1"), at.given("in2")),
    "subtract": lambda at: at.each(_minus, at.given("in1"), at.given("in2")),
    "multiply": lambda at: at.each(_times, at.given("in1"), at.given("in2", 1)),
    "divide": _divided,
    "mix": _mixed,
    "clamp": _clamped,
}
"""How nodes are read, by kind; other nodes cannot be read."""
