"""A glTF document with baked textures in the place of its own, as one GLB; everything else as it was."""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mipbake.base.errors import InputError, UsageError
from mipbake.source.gltf import container, uris
from mipbake.source.gltf.bakes import GltfBake
from mipbake.source.gltf.buffers import Binary, merged
from mipbake.source.gltf.document import Document, Json
from mipbake.source.gltf.images import BASISU, KTX2, stored_image
from mipbake.source.gltf.plain import SIDE, PlainTexture
from mipbake.source.gltf.slots import ANISOTROPIC, ANISOTROPY, BASE_COLOUR, EMISSIVE, info_of, made_holder
from mipbake.source.gltf.uses import extensions_of, image_uses, view_uses
from mipbake.source.images.ktx2 import IDENTIFIER
from mipbake.stack.gltf.ranges import Ranges
from mipbake.stack.gltf.retexture import Replaced, replace_textures

COLOUR_SLOTS = (BASE_COLOUR, EMISSIVE)
"""Slots whose maps are sRGB-encoded."""

_DESCRIPTOR_AT = 48
_UASTC, _RGBSDA = 166, 1  # colour models
_SRGB, _DATA = (1, 2), {"none": (0, 1), "BT.709": (1, 1)}  # primaries and transfer function
_EIGHT_BITS = 37, 43  # VK_FORMAT_R8G8B8A8_UNORM and _SRGB


@dataclass(frozen=True, eq=False)
class GltfResult:
    """A finished bake.

    Args:
        bake: of the document that is written.
        maps: slot to a complete KTX 2 file, UASTC or RGBA of 8 bits, sides multiples of 4: of `bake.slots` those that
            are replaced. baseColorTexture is sRGB-encoded, the others are linear (descriptor of UASTC with unspecified
            primaries).
        ranges: what the materials multiply the values in the maps by.
    """

    bake: GltfBake
    maps: Mapping[str, bytes]
    ranges: Ranges = field(default_factory=Ranges)


def rewritten(
    document: Document,
    results: Sequence[GltfResult],
    provenance: Mapping[str, Any],
    plain: Sequence[tuple[PlainTexture, bytes]] = (),
) -> bytes:
    """A GLB of the document in which the materials of the results show the baked maps, and others averaged textures.

    Factors that the bake took in become 1, or what the ranges of a result say. An occlusion that lay in the
    metallicRoughness image follows it, as the amount of a clearcoat follows its roughness. A result without an
    anisotropyTexture makes a material isotropic whose anisotropy the bake took in. Images that nothing else uses give
    their place to the new ones; all indices stay what they were. Buffers, external files and data URIs go into the BIN
    chunk. Unknown extensions, extras and compressed geometry are kept.

    Args:
        document: as it was read.
        results: bakes of `read_materials` of the same document, none twice.
        provenance: JSON values that say how the maps were made: `asset.extras.mipbake`.
        plain: textures of `read_materials` with complete KTX 2 files, made like the files of the maps.

    Raises:
        UsageError: a map for a slot that the bake does not fill, a material in two results, or a map that
            KHR_texture_basisu does not take.
        InputError: an image that stays is missing. OutputError: the file would be larger than a GLB can be.
    """
    _check(document, results)
    made: Json = copy.deepcopy(document.json)
    for result in results:
        for index in result.bake.materials:
            _settle_factors(made["materials"][index], result)
    replaced = replace_textures(document, made, [(r.bake, r.maps) for r in results], plain)
    for result in results:
        for index in result.bake.materials:
            _set_ranges(made["materials"][index], result)
    views = _settle_images(made, replaced)
    binary = merged(made, document.buffers, [view for view in views if view < len(document.all("bufferViews"))])
    _embed_images(document, made, binary)
    for content, data in replaced.contents.items():
        place = {"buffer": 0, "byteOffset": binary.add(data), "byteLength": len(data)}
        for view in (view for view, key in views.items() if key == content):
            kept = {key: value for key, value in made["bufferViews"][view].items() if key in ("name", "extras")}
            made["bufferViews"][view] = {**place, **kept}
    if replaced.contents:
        _declare(made, extensions_of(document.json))
    made["asset"]["extras"] = _with_provenance(made["asset"].get("extras"), provenance)
    return finished(made, binary, document.chunks)


def check_images(document: Document, bakes: Sequence[GltfBake]) -> None:
    """InputError where an image that the bakes leave in the document cannot be read, which `rewritten` finds late."""
    made: Json = copy.deepcopy(document.json)
    maps = [
        # What is in a map is of no matter for which images it takes the place of.
        (bake, {s: f"{bake.name}/{s}".encode() for s in bake.slots if s != ANISOTROPIC or "anisotropy" in roles})
        for bake in bakes
        for roles in [bake.options.maps]
    ]
    _settle_images(made, replace_textures(document, made, maps))
    _embed_images(document, made, Binary())


def finished(made: Json, binary: Binary, chunks: Sequence[tuple[bytes, bytes]] = ()) -> bytes:
    """The GLB of a document whose first buffer is `binary`."""
    if len(binary):
        made["buffers"][0]["byteLength"] = len(binary)
    else:
        made["buffers"] = made["buffers"][1:]
    for kind in ("buffers", "bufferViews"):
        if not made.get(kind):
            made.pop(kind, None)
    text = json.dumps(made, separators=(",", ":"), allow_nan=False).encode()
    return container.packed(text, binary.taken(), chunks)


def check_map(name: str, slot: str, data: bytes) -> None:
    """UsageError where KHR_texture_basisu does not take a file in a slot (its section on KTX v2 images).

    Plain RGBA of eight bits passes too: the extension has no place for it, but three.js and Babylon.js load it there.
    """
    what = f"the map {slot} of {name}"
    if data[: len(IDENTIFIER)] != IDENTIFIER or len(data) < 80:
        raise UsageError(f"{what} is not a KTX 2 file: expected one of UASTC blocks")
    vulkan, _, width, height = struct.unpack_from("<4I", data, len(IDENTIFIER))
    if vulkan not in (0, *_EIGHT_BITS):
        raise UsageError(
            f"{what} has the Vulkan format {vulkan}: expected UASTC, which has 0, or RGBA of 8 bits, which has "
            f"{' or '.join(str(each) for each in _EIGHT_BITS)}"
        )
    if width % SIDE or height % SIDE or not width * height:
        raise UsageError(
            f"{what} is {width} x {height} texels: KHR_texture_basisu takes multiples of {SIDE}, resample it first"
        )
    (descriptor,) = struct.unpack_from("<I", data, _DESCRIPTOR_AT)
    found, colour = tuple(data[descriptor + 12 : descriptor + 15]), slot in COLOUR_SLOTS
    model, data_primaries = (_RGBSDA, "BT.709") if vulkan else (_UASTC, "none")
    if found != (model, *(_SRGB if colour else _DATA[data_primaries])):
        expected = "sRGB with the primaries of BT.709" if colour else f"linear, primaries: {data_primaries}"
        raise UsageError(
            f"{what} has the colour model, primaries and transfer function {found}: expected "
            f"{'RGBA' if vulkan else 'UASTC'}, {expected}"
        )


def _check(document: Document, results: Sequence[GltfResult]) -> None:
    seen: dict[tuple[int, str], str] = {}
    for result in results:
        name = result.bake.name
        for slot, data in result.maps.items():
            if slot not in result.bake.slots:
                raise UsageError(
                    f"{name} has no slot {slot!r} to fill: expected some of {', '.join(result.bake.slots)}"
                )
            check_map(name, slot, data)
        for index in result.bake.materials:
            document.one("materials", index, f"the bake {name}")
            lobe = (index, result.bake.lobe.roughness)
            if lobe in seen:
                raise UsageError(f"material {index} is in the bakes {seen[lobe]} and {name}: expected one")
            seen[lobe] = name


def _settle_factors(material: Json, result: GltfResult) -> None:
    """Makes 1 of what the maps hold already. A factor that is not there is 1 by itself."""
    maps, lobe = result.maps, result.bake.lobe
    if lobe.roughness in maps:
        holder = made_holder(material, lobe.keys)
        for key, default in lobe.factors:
            if holder.get(key, default) != 1:
                holder[key] = 1
    normal = info_of(material, lobe.normal)
    if lobe.normal in maps and normal is not None and normal.get("scale", 1) != 1:
        normal["scale"] = 1
    if ANISOTROPIC in maps:
        anisotropy = material.setdefault("extensions", {}).setdefault(ANISOTROPY, {})
        anisotropy |= {"anisotropyStrength": 1, "anisotropyRotation": 0}
    elif maps and "anisotropy" in result.bake.options.maps:
        del material["extensions"][ANISOTROPY]
        if not material["extensions"]:
            del material["extensions"]


def _set_ranges(material: Json, result: GltfResult) -> None:
    """Writes the factors that bring the values of stretched maps back, once the material has its textures."""
    maps, ranges, lobe = result.maps, result.ranges, result.bake.lobe
    if lobe.roughness in maps and ranges.roughness != 1:
        made_holder(material, lobe.keys)[lobe.factors[0][0]] = ranges.roughness
    normal = info_of(material, lobe.normal)
    if lobe.normal in maps and normal is not None and ranges.normal != 1:
        normal["scale"] = ranges.normal


def _settle_images(made: Json, replaced: Replaced) -> dict[int, str]:
    """Gives every content an image, in the place of one that nothing uses any more where there is such.

    Returns:
        bufferView to the content that it is to hold; the bufferViews of old images have no content.
    """
    images, all_views = made.setdefault("images", []), made.setdefault("bufferViews", [])
    used = {use.index for use in image_uses(made)}
    shared = [use.index for use in view_uses(made)]
    free = {image: content for content, before in replaced.images.items() for image in before if image not in used}
    image_of: dict[str, int] = {}
    views: dict[int, str] = {}
    view_of: dict[str, int] = {}
    for image, content in free.items():
        image_of.setdefault(content, image)
        view = images[image].get("bufferView")
        if view is not None and shared.count(view) == 1:
            views[view] = content
            view_of.setdefault(content, view)
    for content in replaced.contents:
        if content not in view_of:
            all_views.append({})
            view_of[content] = len(all_views) - 1
            views[view_of[content]] = content
        if content not in image_of:
            images.append({})
            image_of[content] = len(images) - 1
    for content, image in image_of.items():
        _point(images[image], view_of[content])
    for image, content in free.items():
        if image != image_of[content]:  # the index stays, so it shows the same as the image that it gave way to
            own = images[image].get("bufferView")
            _point(images[image], own if own in views else view_of[content])
    for content, textures in replaced.textures.items():
        for texture in textures:
            made["textures"][texture]["extensions"][BASISU]["source"] = image_of[content]
    return views


def _point(image: Json, view: int) -> None:
    image.pop("uri", None)
    image |= {"mimeType": KTX2.mime, "bufferView": view}


def _embed_images(document: Document, made: Json, binary: Binary) -> None:
    """Takes the images that stay from their files and data URIs; addresses in a network stay addresses.

    An address stays as well where nothing shows the image and the image cannot be read: it breaks nothing, here as in
    the source.
    """
    shown = {use.index for use in image_uses(document.json)}
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
            made["bufferViews"].append({"buffer": 0, "byteOffset": binary.add(data), "byteLength": len(data)})
            image |= {"mimeType": kind.mime, "bufferView": len(made["bufferViews"]) - 1}
    if not made["images"]:
        del made["images"]


def _declare(made: Json, before: set[str]) -> None:
    """Names the extensions that are there now, and no longer those that were there before and have gone."""
    present = extensions_of(made)
    gone = before - present
    for key, needed in (("extensionsUsed", {BASISU, ANISOTROPY} & present), ("extensionsRequired", {BASISU})):
        kept = [name for name in made.get(key, []) if name not in gone]
        made[key] = kept + sorted(needed - set(kept))


def _with_provenance(extras: Any, provenance: Mapping[str, Any]) -> Json:
    """What the asset had, and the provenance; extras that are not an object move into one."""
    kept = extras if isinstance(extras, dict) else {} if extras is None else {"extras": extras}
    return {**kept, "mipbake": dict(provenance)}
