"""Which textures of a document show a baked map from now on: in place where nothing else uses them, else new ones."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mipbake.source.gltf.bakes import GltfBake
from mipbake.source.gltf.document import Document, Json
from mipbake.source.gltf.images import BASISU, SOURCE_EXTENSIONS, content_key, source_of
from mipbake.source.gltf.plain import PlainTexture
from mipbake.source.gltf.slots import ANISOTROPIC, PLACES, info_of, made_holder, surface_mapping
from mipbake.source.gltf.uses import texture_uses


@dataclass(frozen=True)
class Replaced:
    """What is to be shown, by content: the hash of a map's bytes.

    Args:
        contents: content to the map.
        textures: content to the textures that show it; the image that they name is still to be found.
        images: content to the images that those who show it showed before, in order.
    """

    contents: dict[str, bytes] = field(default_factory=dict)
    textures: dict[str, list[int]] = field(default_factory=dict)
    images: dict[str, list[int]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Want:
    """A textureInfo that is to show a content.

    Args:
        info: the textureInfo. texture: that it has had; None for a new one.
        sampler: index of the one that it keeps or gets, None for the default.
    """

    info: Json
    texture: int | None
    sampler: int | None
    content: str


def replace_textures(
    document: Document,
    made: Json,
    results: Sequence[tuple[GltfBake, Mapping[str, bytes]]],
    plain: Sequence[tuple[PlainTexture, bytes]] = (),
) -> Replaced:
    """Lets the materials of the bakes show their maps, and others their averaged textures.

    Args:
        document: as it was read. made: a copy of its JSON, which is changed.
        results: each bake with its maps: slot to KTX 2 file.
        plain: each averaged texture with its KTX 2 file.
    """
    replaced = Replaced()
    wants: list[_Want] = []
    for bake, maps in results:
        for index in bake.materials:
            for slot, data in maps.items():
                content = hashlib.sha256(data).hexdigest()
                replaced.contents.setdefault(content, data)
                wants += _wants(document, bake, index, made["materials"][index], slot, content)
    for texture, data in plain:
        content = hashlib.sha256(data).hexdigest()
        replaced.contents.setdefault(content, data)
        for index, slot in texture.uses:
            info = info_of(made["materials"][index], slot)
            if info is None:
                raise AssertionError(f"{slot} of material {index} has been read")
            sampler = document.all("textures")[info["index"]].get("sampler")
            wants.append(_Want(info, info["index"], sampler, content))
    for want in wants:
        if want.texture is not None:
            before = replaced.images.setdefault(want.content, [])
            before += [i for i in _images(document, want.texture) if i not in before]
    _assign(made, wants, replaced)
    return replaced


def _wants(document: Document, bake: GltfBake, index: int, material: Json, slot: str, content: str) -> list[_Want]:
    """The textureInfos of a material that a slot's map is for; those that it lacked are made."""
    textures = document.all("textures")
    before, lobe = document.all("materials")[index], bake.lobe
    main = info_of(before, lobe.normal) or info_of(before, lobe.roughness)
    if main is None:
        raise AssertionError(f"material {index} has something to bake")
    holder = made_holder(material, PLACES[slot].keys)
    info = info_of(material, slot)
    shown = None if info is None else info["index"]
    sampler = textures[main["index"] if shown is None else shown].get("sampler")
    if info is None or slot == ANISOTROPIC:
        holder[slot] = info = {"index": shown, **surface_mapping(main)}
    wants = [_Want(info, shown, sampler, content)]
    red = info_of(material, lobe.red)
    if slot == lobe.roughness and shown is not None and red and bake.options.maps.get("occlusion"):
        keys = {content_key(document, source_of(document, t, slot), slot) for t in (shown, red["index"])}
        if len(keys) == 1:
            wants.append(_Want(red, red["index"], textures[red["index"]].get("sampler"), content))
    return wants


def _images(document: Document, texture: int) -> list[int]:
    """The images that a texture names, its source first."""
    found = document.all("textures")[texture]
    extensions = found.get("extensions")
    named = [extensions.get(name) for name in SOURCE_EXTENSIONS] if isinstance(extensions, dict) else []
    holders = [found, *(each for each in named if isinstance(each, dict))]
    return list(dict.fromkeys(holder["source"] for holder in holders if "source" in holder))


def _assign(made: Json, wants: Sequence[_Want], replaced: Replaced) -> None:
    """Gives every want a texture: its own texture where everything that uses this texture wants the same, else a new
    texture."""
    mine = {id(want.info) for want in wants}
    kept = {use.index for use in texture_uses(made) if use.parent is not None and id(use.parent) not in mine}
    taken: dict[int, str] = {}
    fresh: dict[tuple[str, int | None], int] = {}
    textures = made.setdefault("textures", [])
    for want in wants:
        index = want.texture
        if index is not None and index not in kept and taken.setdefault(index, want.content) == want.content:
            _show(textures[index])
        else:
            key = (want.content, want.sampler)
            if key not in fresh:
                sampler = {} if want.sampler is None else {"sampler": want.sampler}
                textures.append(sampler)
                fresh[key] = len(textures) - 1
                _show(textures[-1])
            index = fresh[key]
        want.info["index"] = index
        several = replaced.textures.setdefault(want.content, [])
        if index not in several:
            several.append(index)


def _show(texture: Json) -> None:
    """Leaves of a texture what is not about its image."""
    texture.pop("source", None)
    extensions = texture.get("extensions")
    if not isinstance(extensions, dict):
        extensions = texture["extensions"] = {}
    for name in SOURCE_EXTENSIONS:
        extensions.pop(name, None)
    extensions[BASISU] = {}
