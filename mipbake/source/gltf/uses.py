"""What uses which texture, image, bufferView and buffer of a glTF document, in extensions that nobody here knows too.

The core's uses are known exactly. In extensions, whole numbers beneath a key with "texture" or "image" in its name
count as indices: too many are found rather than too few, and what is found to be used stays. `extras` hold no
uses that anybody could know.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, TypeAlias

from mipbake.source.gltf.document import Json, extensions_in

_ELSEWHERE = ("asset", "extras", "textures", "images", "accessors", "bufferViews", "buffers")
"""Members of a document that name no texture and no image, or are looked at apart."""

Use: TypeAlias = tuple[Any, int]
"""An index, and the object or array that it stands in."""


def texture_uses(document: Json) -> list[Use]:
    """Every place that names a texture."""
    return [use for word, use in _uses(document) if word == "texture"]


def used_images(document: Json) -> set[int]:
    """Images that are named: by textures, their extensions, and extensions of anything else."""
    found = {index for word, (_, index) in _uses(document) if word == "image"}
    for texture in document.get("textures", []):
        holders = [texture, *extensions_in(texture).values()]
        found |= {h["source"] for h in holders if isinstance(h, dict) and _is_index(h.get("source"))}
    return found


def objects_with(document: Json, key: str) -> list[Json]:
    """Every object that names a bufferView or a buffer by that key. What lies in a buffer has `byteOffset` where it
    is not 0."""
    return [each for each in _objects(document) if _is_index(each.get(key))]


def extensions_of(document: Json) -> set[str]:
    """Names of the extensions that some object has."""
    return {name for each in _objects(document) for name in extensions_in(each)}


def animated_members(document: Json) -> dict[int, set[str]]:
    """Members of materials that animations set through KHR_animation_pointer: material to paths within it."""
    found: dict[int, set[str]] = {}
    for each in _objects(document.get("animations")):
        target = extensions_in(each).get("KHR_animation_pointer")
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
        yield from _in_extensions(texture.get("extensions"))


def _in_extensions(extensions: Any) -> Iterator[tuple[str, Use]]:
    """An extension's own name says nothing of the numbers in it: KHR_texture_transform holds no textures."""
    for extension in extensions.values() if isinstance(extensions, dict) else ():
        yield from _walked(extension, (), inside=True)


def _walked(node: Any, words: tuple[str, ...], inside: bool = False) -> Iterator[tuple[str, Use]]:
    """`words` are the keys above, `inside` says whether an extension is among them."""
    members = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in members:
        if key == "extras":
            continue
        if key == "extensions":
            yield from _in_extensions(value)
            continue
        below = (*words, key.casefold()) if isinstance(key, str) else words
        info = isinstance(value, dict) and isinstance(key, str) and key.casefold().endswith("texture")
        if info and _is_index(value.get("index")):
            yield "texture", (value, value["index"])
            yield from _in_extensions(value.get("extensions"))
        elif inside and _is_index(value):
            for word in ("texture", "image"):
                if any(word in each for each in below):
                    yield word, (node, value)
        else:
            yield from _walked(value, below, inside)
