"""A glTF document changed: materials show other image files, and all bytes that are still needed lie in one buffer."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

from mipbake.base.errors import InputError
from mipbake.source.gltf import uris
from mipbake.source.gltf.document import Document, Json, extensions_in
from mipbake.source.gltf.images import BASISU, KTX2, SOURCE_EXTENSIONS, ImageKind, sources_of, stored_image
from mipbake.source.gltf.uses import extensions_of, objects_with, texture_uses, used_images

_STEP = 16
"""Bytes are taken away in multiples of this, so that what lies behind them keeps its alignment."""

Interval = tuple[int, int]


class Binary:
    """The bytes of a GLB's BIN chunk, as they grow."""

    def __init__(self) -> None:
        self.data = bytearray()

    def add(self, data: bytes, alignment: int = 4) -> int:
        """Appends data and returns its offset."""
        self.data += bytes(-len(self.data) % alignment)
        self.data += data
        return len(self.data) - len(data)

    def view(self, data: bytes) -> Json:
        """Appends data and returns a bufferView of it."""
        return {"buffer": 0, "byteOffset": self.add(data), "byteLength": len(data)}


@dataclass(frozen=True, eq=False)
class Want:
    """A textureInfo that is to show an image file.

    Args:
        info: the textureInfo, in the JSON that is changed.
        texture: index of the texture that it showed; None for none.
        sampler: index of the one that it keeps or gets; None for the default.
        data: the image file.
        name: of its image; "" for the name of the image that it takes the place of.
    """

    info: Json
    texture: int | None
    sampler: int | None
    data: bytes
    name: str = ""

    @cached_property
    def content(self) -> str:
        """Equal for equal files."""
        return hashlib.sha256(self.data).hexdigest()


def retextured(document: Document, made: Json, wants: Sequence[Want], kind: ImageKind, embed: bool) -> Binary:
    """Lets textureInfos show image files of one kind, and joins the buffers into the one that is returned. A texture is
    changed in place where all that shows it wants the same file, else there is a new one. Images that nothing shows any
    more give their places and their bytes to the files that take over; all indices stay.

    Args:
        made: a copy of the document's JSON, which is changed.
        embed: whether images that stay are taken in from their files and data URIs; InputError where one is missing.
    """
    files = {want.content: want for want in reversed(wants)}
    contents = list(dict.fromkeys(want.content for want in wants))
    textures = _assigned(made, wants)
    image_of, views = _placed(document, made, wants, contents, kind)
    for content in contents:
        if files[content].name:
            made["images"][image_of[content]]["name"] = files[content].name
    for texture, content in textures.items():
        holder = made["textures"][texture]
        if kind is KTX2:
            holder["extensions"] = {**extensions_in(holder), BASISU: {"source": image_of[content]}}
        else:
            holder["source"] = image_of[content]
    binary = _merged(made, document.buffers, [view for view in views if view < len(document.all("bufferViews"))])
    if embed:
        _embed_images(document, made, binary)
    for content in contents:
        place = binary.view(files[content].data)
        for view in (view for view, key in views.items() if key == content):
            kept = {key: value for key, value in made["bufferViews"][view].items() if key in ("name", "extras")}
            made["bufferViews"][view] = {**place, **kept}
    return binary


def drop_extensions(document: Document, made: Json) -> None:
    """No longer names extensions that some object of the document had, and none of the changed one has."""
    gone = extensions_of(document.json) - extensions_of(made)
    for listing in ("extensionsUsed", "extensionsRequired"):
        if listing in made:
            made[listing] = [name for name in made[listing] if name not in gone]


def drop_empty(made: Json) -> None:
    """Removes arrays that hold nothing: glTF does not allow them."""
    for kind in ("extensionsUsed", "extensionsRequired", "images", "textures", "bufferViews", "buffers"):
        if not made.get(kind):
            made.pop(kind, None)


def _assigned(made: Json, wants: Sequence[Want]) -> dict[int, str]:
    """Gives every want a texture without images. Returns texture to content, in the order of the wants."""
    mine = {id(want.info) for want in wants}
    kept = {index for parent, index in texture_uses(made) if id(parent) not in mine}
    taken: dict[int, str] = {}
    fresh: dict[tuple[str, int | None], int] = {}
    textures = made.setdefault("textures", [])
    for want in wants:
        index = want.texture
        if index is None or index in kept or taken.setdefault(index, want.content) != want.content:
            key = (want.content, want.sampler)
            if key not in fresh:
                textures.append({} if want.sampler is None else {"sampler": want.sampler})
                fresh[key] = len(textures) - 1
            index = fresh[key]
            taken[index] = want.content
        want.info["index"] = index
    for index in taken:
        textures[index].pop("source", None)
        others = {k: v for k, v in extensions_in(textures[index]).items() if k not in SOURCE_EXTENSIONS}
        textures[index].pop("extensions", None)
        if others:
            textures[index]["extensions"] = others
    return taken


def _placed(
    document: Document, made: Json, wants: Sequence[Want], contents: Sequence[str], kind: ImageKind
) -> tuple[dict[str, int], dict[int, str]]:
    """Gives every content an image, in the place of one that nothing uses any more where there is such. Returns content
    to its image; and bufferView to the content that it is to hold, old ones among them."""
    images, all_views = made.setdefault("images", []), made.setdefault("bufferViews", [])
    used, shared = used_images(made), [each["bufferView"] for each in objects_with(made, "bufferView")]
    before: dict[str, dict[int, None]] = {content: {} for content in contents}
    for want in wants:
        if want.texture is not None:
            before[want.content] |= {int(str(i)): None for i in sources_of(document.all("textures")[want.texture])}
    free = {image: content for content in contents for image in before[content] if image not in used}
    image_of: dict[str, int] = {}
    views: dict[int, str] = {}
    view_of: dict[str, int] = {}
    for image, content in free.items():
        image_of.setdefault(content, image)
        view = images[image].get("bufferView")
        if view is not None and shared.count(view) == 1:
            views[view] = content
            view_of.setdefault(content, view)
    for content in contents:
        if content not in view_of:
            all_views.append({})
            view_of[content] = len(all_views) - 1
            views[view_of[content]] = content
        if content not in image_of:
            images.append({})
            image_of[content] = len(images) - 1
    # The indices of other images that gave way stay, so they show the same.
    for image, content in {**{i: c for c, i in image_of.items()}, **free}.items():
        own = images[image].get("bufferView")
        images[image].pop("uri", None)
        view = own if image != image_of[content] and own in views else view_of[content]
        images[image] |= {"mimeType": kind.mime, "bufferView": view}
    return image_of, views


def _embed_images(document: Document, made: Json, binary: Binary) -> None:
    """Takes the images that stay from their files and data URIs; addresses in a network stay addresses.

    An address stays as well where nothing shows the image and the image cannot be read: it breaks nothing, here as in
    the source.
    """
    shown = used_images(document.json)
    for index, image in enumerate(made["images"]):
        uri = image.get("uri")
        if isinstance(uri, str) and not uris.is_remote(uri):
            try:
                data, kind = stored_image(document, index)
            except InputError:
                if index in shown:
                    raise
                continue
            del image["uri"]
            made["bufferViews"].append(binary.view(data))
            image |= {"mimeType": kind.mime, "bufferView": len(made["bufferViews"]) - 1}


def _merged(document: Json, buffers: Sequence[bytes | None], dropped: Collection[int]) -> Binary:
    """One buffer in place of all that have bytes, without the bytes that nobody needs; every use is moved along. The
    new buffer is the first, as a GLB wants it; placeholders without bytes (None) follow in their order.

    Args:
        document: its `buffers`, and every object with `buffer` and `byteOffset`, are changed.
        dropped: bufferViews whose bytes nobody needs. What something else lies in as well is kept.
    """
    uses = objects_with(document, "buffer")
    dead = {id(document["bufferViews"][index]) for index in dropped}
    binary = Binary()
    described = document.get("buffers", [])
    whole = [index for index, data in enumerate(buffers) if data is not None]
    placeholders = [index for index, data in enumerate(buffers) if data is None]
    # Its name and what else it says; not that it is what an extension decompresses, which no longer is true of all.
    first = {key: value for i in whole[:1] for key, value in described[i].items() if key in ("name", "extras")}
    document["buffers"] = [first, *(described[index] for index in placeholders)]
    moves = []
    for index, data in enumerate(buffers):
        here = [use for use in uses if use["buffer"] == index]
        if data is None:
            moves += [(use, 1 + placeholders.index(index), None) for use in here]
            continue
        dying, living = ([_range(u, len(data)) for u in here if (id(u) in dead) is gone] for gone in (True, False))
        cuts = [(low, low + (high - low) // _STEP * _STEP) for low, high in _without(dying, living)]
        ends = [0, *(end for _, end in cuts)]
        starts = [*(start for start, _ in cuts), len(data)]
        base = binary.add(b"".join(data[low:high] for low, high in zip(ends, starts, strict=True)), _STEP)
        for use in here:
            offset = use.get("byteOffset", 0)
            moves.append((use, 0, base + offset - sum(high - low for low, high in cuts if high <= offset)))
    for use, buffer, offset in moves:
        use["buffer"] = buffer
        if offset or (offset is not None and "byteOffset" in use):
            use["byteOffset"] = offset
    return binary


def _range(use: Json, size: int) -> Interval:
    """The bytes that an object lies in: to the end of the buffer where its length is not given."""
    start, length = use.get("byteOffset", 0), use.get("byteLength")
    return start, start + length if isinstance(length, int) else size


def _without(freed: Sequence[Interval], needed: Sequence[Interval]) -> list[Interval]:
    """What of the freed intervals no needed one touches, joined and in ascending order."""
    found: list[Interval] = []
    for start, end in sorted(freed):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((start, end))
    for low, high in needed:
        pieces = (piece for start, end in found for piece in ((start, min(end, low)), (max(start, high), end)))
        found = [piece for piece in pieces if piece[0] < piece[1]]
    return found
