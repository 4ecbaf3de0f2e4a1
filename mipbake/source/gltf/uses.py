"""What uses which texture, image, bufferView and buffer of a glTF document, in extensions that nobody here knows too.

The core's uses are told exactly. In extensions, whole numbers beneath a key with "texture" or "image" in its name
count as indices: too many are found rather than too few, and what is found to be used stays. `extras` hold no
uses that anybody could know.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

Json = dict[str, Any]

_ELSEWHERE = ("asset", "extras", "textures", "images", "accessors", "bufferViews", "buffers")
"""Members of a document that name no texture and no image, or are looked at apart."""


@dataclass(frozen=True, eq=False)
class Use:
    """A place that holds the index of a texture or an image.

    Args:
        parent: the object or array that it stands in. key: where in it.
    """

    parent: Any
    key: str | int

    @property
    def index(self) -> int:
        """What stands there."""
        return int(self.parent[self.key])


def texture_uses(document: Json) -> list[Use]:
    """Every place that names a texture."""
    return [use for word, use in _uses(document) if word == "texture"]


def image_uses(document: Json) -> list[Use]:
    """Every place that names an image: textures, their extensions, and extensions of anything else."""
    found = [use for word, use in _uses(document) if word == "image"]
    for texture in document.get("textures", []):
        extensions = texture.get("extensions")
        holders = [texture, *(extensions.values() if isinstance(extensions, dict) else [])]
        found += [Use(h, "source") for h in holders if isinstance(h, dict) and _is_index(h.get("source"))]
    return found


def view_uses(document: Json) -> list[Use]:
    """Every place that names a bufferView by the key `bufferView`."""
    return [Use(each, "bufferView") for each in _objects(document) if _is_index(each.get("bufferView"))]


def buffer_uses(document: Json) -> list[Json]:
    """Every object that lies in a buffer: it has `buffer`, and `byteOffset` where that is not 0."""
    return [each for each in _objects(document) if _is_index(each.get("buffer"))]


def extensions_of(document: Json) -> set[str]:
    """Names of the extensions that some object has."""
    return {n for each in _objects(document) if isinstance(each.get("extensions"), dict) for n in each["extensions"]}


def animated_members(document: Json) -> dict[int, set[str]]:
    """Members of materials that animations set through KHR_animation_pointer: material to paths within it."""
    found: dict[int, set[str]] = {}
    for each in _objects(document.get("animations")):
        extensions = each.get("extensions")
        target = extensions.get("KHR_animation_pointer") if isinstance(extensions, dict) else None
        pointer = target.get("pointer") if isinstance(target, dict) else None
        if isinstance(pointer, str) and (named := re.fullmatch(r"/materials/([0-9]{1,9})/(.+)", pointer)):
            found.setdefault(int(named[1]), set()).add(named[2])
    return found


def _is_index(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _objects(node: Any) -> Iterator[Json]:
    """Every object of a document but those in `extras`, parents first."""
    waiting = [node]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict):
            yield each
            waiting += [value for key, value in each.items() if key != "extras"]
        elif isinstance(each, list):
            waiting += each


def _uses(document: Json) -> Iterator[tuple[str, Use]]:
    for key, value in document.items():
        if key == "extensions":
            yield from _in_extensions(value)
        elif key not in _ELSEWHERE:
            yield from _walked(value, ())
    for texture in document.get("textures", []):
        extensions = texture.get("extensions")
        for name, extension in extensions.items() if isinstance(extensions, dict) else ():
            # `source` is an image, as `image_uses` has it.
            others = {k: v for k, v in extension.items() if k != "source"} if isinstance(extension, dict) else extension
            yield from _walked(others, (), inside=bool(name))


def _in_extensions(extensions: Any) -> Iterator[tuple[str, Use]]:
    """An extension's own name says nothing of the numbers in it: KHR_texture_transform holds no textures."""
    if isinstance(extensions, dict):
        for extension in extensions.values():
            yield from _walked(extension, (), inside=True)


def _walked(node: Any, words: Sequence[str], inside: bool = False) -> Iterator[tuple[str, Use]]:
    """`words` are the keys above, `inside` tells whether an extension is among them."""
    members = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in members:
        if key == "extras":
            continue
        if key == "extensions":
            yield from _in_extensions(value)
            continue
        below = (*words, key.casefold()) if isinstance(key, str) else words
        if isinstance(value, dict) and _is_texture_info(key, value):
            yield "texture", Use(value, "index")
            yield from _walked({k: v for k, v in value.items() if k == "extensions"}, (), inside)
        elif inside and _is_index(value):
            for word in ("texture", "image"):
                if any(word in each for each in below):
                    yield word, Use(node, key)
        else:
            yield from _walked(value, below, inside)


def _is_texture_info(key: object, value: Json) -> bool:
    return isinstance(key, str) and key.casefold().endswith("texture") and _is_index(value.get("index"))
