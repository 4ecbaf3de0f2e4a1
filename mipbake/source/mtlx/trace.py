"""What reaches an input of a MaterialX shader: channels of textures, scaled and shifted, or constants.

Node graphs are read symbolically. Every channel of a signal is an affine function of one channel of a texture, a
constant, or something that cannot be read, and why.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mipbake.source.mtlx.document import Dangling, Document, Element, Given, Link, Scope, Value
from mipbake.source.mtlx.signal import (
    LETTERS,
    POSITIONS,
    Channel,
    Signal,
    Texture,
    constant,
    converted,
    each,
    minus,
    numbers,
    picked,
    plus,
    taken,
    times,
    unread,
)

USD_IMAGE = "UsdUVTexture"
IMAGES = ("image", "tiledimage", "gltf_image", "gltf_colorimage", "gltf_normalmap", "gltf_anisotropy_image", USD_IMAGE)

MAX_DEPTH = 48
"""Nodes in a row that are followed: far more than there are between a texture and its shader."""

_ADDRESS = {"periodic": "wrap", "repeat": "wrap", "clamp": "clamp", "mirror": "mirror", "constant": "constant"}
_ADDRESS |= {"black": "constant"}
_PLACING = {"uvtiling": 1.0, "uvoffset": 0.0, "realworldimagesize": 1.0, "realworldtilesize": 1.0, "scale": 1.0}
_PLACING |= {"offset": 0.0, "rotate": 0.0, "uvindex": 0.0, "texcoord": 0.0, "st": 0.0, "frameoffset": 0.0}


@dataclass
class Tracer:
    """Follows the inputs of one document; every node is visited once."""

    document: Document
    _seen: dict[tuple[int, int, int, str], Signal | None] = field(default_factory=dict)
    _depth: int = 0

    def input(self, node: Element, name: str, scope: Scope) -> Signal | None:
        """What an input of a node holds; None where it is left at its default."""
        return self._signal(self.document.given(node, name, scope))

    def trace(self, link: Link) -> Signal:
        """What an output of a node holds."""
        source = self.document.source_of(link)
        if isinstance(source, Dangling):
            return unread(source.text)
        node, scope = source.node, source.scope
        key = (id(node), id(scope.container), id(scope.instance), source.output)
        if key not in self._seen:
            if self._depth >= MAX_DEPTH:
                return unread(f"more than {MAX_DEPTH} nodes in a row")
            self._seen[key] = None  # at work: who comes here again has gone in a circle
            operation = _NODES.get(node.tag)
            self._depth += 1
            self._seen[key] = unread(_label(node)) if operation is None else operation(_At(self, node, scope, source))
            self._depth -= 1
        signal = self._seen[key]
        if signal is None:
            return unread(f"a loop through {node.get('name')}")
        for letters in source.channels:
            signal = taken(signal, letters)
        return signal

    def _signal(self, given: Given) -> Signal | None:
        if given is None:
            return None
        if isinstance(given, Dangling):
            return unread(given.text)
        if isinstance(given, Value):
            values = numbers(given.text)
            return unread(f"the value {given.text!r}") if values is None else constant(*values)
        return self.trace(given)


@dataclass(frozen=True)
class _At:
    """A node that is being read."""

    tracer: Tracer
    node: Element
    scope: Scope
    link: Link

    def given(self, name: str, default: float = 0) -> Signal:
        signal = self.tracer.input(self.node, name, self.scope)
        return constant(default) if signal is None else signal

    def text(self, name: str) -> str | None:
        given = self.tracer.document.given(self.node, name, self.scope)
        return given.text if isinstance(given, Value) else None

    @property
    def label(self) -> str:
        return _label(self.node)


def _label(node: Element) -> str:
    return f"the node {node.tag} ({node.get('name')})"


def _extracted(at: _At) -> Signal:
    index = at.given("index").numbers
    return picked(at.given("in"), int(index[0]) if index else -1)


def _combined(at: _At) -> Signal:
    parts = [at.given(f"in{i + 1}") for i in range(int(at.node.tag[-1]))]
    return Signal(tuple(channel for part in parts for channel in part.channels))


def _divided(at: _At) -> Signal:
    divisor = at.given("in2", 1).numbers
    if divisor is None or 0 in divisor:
        return unread(at.label)
    return each(times, at.given("in1"), constant(*(1 / d for d in divisor)), at.label)


def _mixed(at: _At) -> Signal:
    share = at.given("mix")
    front = each(times, at.given("fg"), share, at.label)
    back = each(times, at.given("bg"), each(minus, constant(1), share, at.label), at.label)
    return each(plus, front, back, at.label)


def _clamped(at: _At) -> Signal:
    """Textures of [0, 1] stay in it, and what a factor drives out of it is clipped after decoding anyway."""
    low, high = at.given("low", 0).numbers or (), at.given("high", 1).numbers or ()
    return at.given("in") if (set(low), set(high)) == ({0}, {1}) else unread(at.label)


def _remapped(at: _At) -> Signal:
    ends = [at.given(n, d).numbers for n, d in (("inlow", 0), ("inhigh", 1), ("outlow", 0), ("outhigh", 1))]
    values = [e[0] for e in ends if e is not None and len(set(e)) == 1]
    if len(values) < len(ends) or values[0] == values[1] or at.given("gamma", 1).numbers != (1,):
        return unread(at.label)
    gain = (values[3] - values[2]) / (values[1] - values[0])
    scaled = each(times, at.given("in"), constant(gain), at.label)
    return each(plus, scaled, constant(values[2] - gain * values[0]), at.label)


def _normal_map(at: _At) -> Signal:
    space, scale = at.text("space") or "tangent", at.given("scale", 1).numbers
    if space != "tangent":
        return unread(f"a normal map in {space} space ({at.node.get('name')})")
    if scale is None:
        return unread(f"a normal map whose scale is not a constant ({at.node.get('name')})")
    return replace(at.given("in"), normal_scale=scale)


def _image(at: _At) -> Signal:
    document, node, scope = at.tracer.document, at.node, at.scope
    file = document.given(node, "file", scope)
    if not isinstance(file, Value) or not file.text.strip():
        return unread(f"an image node without a file ({node.get('name')})")
    kind = {"gltf_normalmap": "vector3", "gltf_anisotropy_image": "vector3"}.get(node.tag, node.get("type", ""))
    kind = kind if kind in LETTERS else "color4"  # a node of several outputs
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
        _placement(document, node, scope, 0),
    )
    signal = Signal(tuple(Channel(texture, letter, 1) for letter in LETTERS[kind]))
    gains = {"gltf_image": "factor", "gltf_colorimage": "color", USD_IMAGE: "scale"}.get(node.tag)
    if gains:
        signal = each(times, signal, at.given(gains, 1), at.label)
    if node.tag == USD_IMAGE:
        signal = each(plus, signal, at.given("bias", 0), at.label)
    return _output(signal, node.tag, at.link.output.removeprefix("out").lower())


def _output(signal: Signal, kind: str, letter: str) -> Signal:
    """What an output of an image node takes of its channels."""
    if kind == "gltf_normalmap":
        return replace(signal, normal_scale=(1.0,))
    if kind == "gltf_anisotropy_image":
        return picked(signal, 2)
    if letter in POSITIONS:
        return picked(signal, POSITIONS[letter])
    return Signal(signal.channels[:3]) if letter in ("color", "rgb") else signal


def _address(at: _At, *names: str) -> str:
    texts = [text for name in names if (text := at.text(name)) is not None]
    return _ADDRESS.get(texts[0], "wrap") if texts else "wrap"


def _placement(document: Document, node: Element, scope: Scope, depth: int) -> tuple[Any, ...]:
    """Inputs that place a texture on the surface and are not at their defaults."""
    placed: list[tuple[Any, ...]] = []
    for entry in node:
        name = entry.get("name", "")
        places = depth or (name in _PLACING and not (node.tag == USD_IMAGE and name == "scale"))
        if entry.tag != "input" or not places or depth > 16:
            continue
        given = document.given(node, name, scope)
        source = document.source_of(given) if isinstance(given, Link) else given
        if isinstance(source, Value):
            values = numbers(source.text)
            if values is None or any(v != _PLACING.get(name, 0.0) for v in values):
                placed.append((name, values or source.text))
        elif isinstance(source, Link):
            inner = _placement(document, source.node, source.scope, depth + 1)
            if inner or source.node.tag not in ("texcoord", "place2d"):
                placed.append((name, source.node.tag, inner))
    return tuple(sorted(placed, key=repr))


_NODES: Mapping[str, Callable[[_At], Signal]] = {
    **dict.fromkeys(IMAGES, _image),
    **dict.fromkeys(("dot", "normalize"), lambda at: at.given("in")),
    **dict.fromkeys(
        ("separate2", "separate3", "separate4"),
        lambda at: picked(at.given("in"), POSITIONS.get(at.link.output[-1:].lower(), -1)),
    ),
    **dict.fromkeys(("combine2", "combine3", "combine4"), _combined),
    **dict.fromkeys(("remap", "range"), _remapped),
    "constant": lambda at: at.given("value"),
    "normalmap": _normal_map,
    "convert": lambda at: converted(at.given("in"), at.node.get("type", "")),
    "swizzle": lambda at: taken(at.given("in"), at.text("channels") or ""),
    "extract": _extracted,
    "invert": lambda at: each(minus, at.given("amount", 1), at.given("in"), at.label),
    "add": lambda at: each(plus, at.given("in1"), at.given("in2"), at.label),
    "subtract": lambda at: each(minus, at.given("in1"), at.given("in2"), at.label),
    "multiply": lambda at: each(times, at.given("in1"), at.given("in2", 1), at.label),
    "divide": _divided,
    "mix": _mixed,
    "clamp": _clamped,
}
"""How nodes are read, by kind; other nodes cannot be read."""
