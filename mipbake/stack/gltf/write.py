"""A glTF document with baked textures in the place of its own, as one GLB; everything else as it was."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mipbake.source.gltf import container
from mipbake.source.gltf import slots as gltf
from mipbake.source.gltf.document import Document, Json
from mipbake.source.gltf.images import BASISU, KTX2, source_of, stored_image
from mipbake.source.gltf.materials import GltfBake
from mipbake.source.gltf.plain import PlainTexture
from mipbake.source.gltf.rewriting import Binary, Want, drop_empty, drop_extensions, retextured
from mipbake.source.gltf.uses import extensions_of
from mipbake.stack.gltf.ranges import Ranges


@dataclass(frozen=True, eq=False)
class GltfResult:
    """A finished bake.

    Args:
        bake: of the document that is written.
        maps: slot to a complete KTX 2 file, UASTC or RGBA of 8 bits, sides multiples of 4: of `bake.slots` those that
            are replaced. baseColorTexture is sRGB-encoded, the others are linear.
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
    InputError where an image that stays is missing, OutputError where the file would be larger than a GLB can be.

    Factors that the bake took in become 1, or what the ranges of a result say. An occlusion that lay in the
    metallicRoughness image follows it, as the amount of a clearcoat follows its roughness. A result without an
    anisotropyTexture makes a material isotropic whose anisotropy the bake took in. Images that nothing else uses give
    their place to the new ones; all indices stay what they were. Buffers, external files and data URIs go into the BIN
    chunk. Unknown extensions, extras and compressed geometry are kept.

    Args:
        results: bakes of `read_materials` of the same document, none twice.
        provenance: JSON values that say how the maps were made: `asset.extras.mipbake`.
        plain: textures of `read_materials` with complete KTX 2 files, made like the files of the maps.
    """
    made: Json = copy.deepcopy(document.json)
    wants = _wants(document, made, results, plain)
    binary = retextured(document, made, wants, KTX2, embed=True)
    if wants:
        drop_extensions(document, made)
        present = extensions_of(made)
        for key, needed in (("extensionsUsed", {BASISU, gltf.ANISOTROPY} & present), ("extensionsRequired", {BASISU})):
            kept = made.get(key, [])
            made[key] = kept + sorted(needed - set(kept))
    extras = made["asset"].get("extras")
    kept = extras if isinstance(extras, dict) else {} if extras is None else {"extras": extras}
    made["asset"]["extras"] = {**kept, "mipbake": dict(provenance)}
    return finished(made, binary, document.chunks)


def check_images(document: Document, bakes: Sequence[GltfBake]) -> None:
    """InputError where an image that the bakes leave in the document cannot be read, which `rewritten` finds late."""
    made: Json = copy.deepcopy(document.json)
    results = []
    for bake in bakes:
        slots = [slot for slot in bake.slots if slot != gltf.ANISOTROPIC or "anisotropy" in bake.options.maps]
        # What is in a map is of no matter for which images it takes the place of.
        results.append(GltfResult(bake, {slot: f"{bake.name}/{slot}".encode() for slot in slots}))
    retextured(document, made, _wants(document, made, results, ()), KTX2, embed=True)


def finished(made: Json, binary: Binary, chunks: Sequence[tuple[bytes, bytes]] = ()) -> bytes:
    """The GLB of a document whose first buffer is `binary`."""
    if binary.data:
        made["buffers"][0]["byteLength"] = len(binary.data)
    else:
        made["buffers"] = made["buffers"][1:]
    drop_empty(made)
    text = json.dumps(made, separators=(",", ":"), allow_nan=False).encode()
    return container.packed(text, bytes(binary.data), chunks)


def _wants(
    document: Document, made: Json, results: Sequence[GltfResult], plain: Sequence[tuple[PlainTexture, bytes]]
) -> list[Want]:
    """Changes the materials of the results; returns what is to show their maps, and the averaged textures."""
    textures = document.all("textures")
    wants: list[Want] = []
    for result in results:
        lobe = result.bake.lobe
        for index in result.bake.materials:
            material = made["materials"][index]
            _set_factors(material, result)
            for slot, data in result.maps.items():
                wants += _of_map(document, result.bake, index, material, slot, data)
            normal = gltf.info_of(material, lobe.normal)
            if lobe.normal in result.maps and normal is not None:
                _set(normal, "scale", 1, result.ranges.normal)
    for texture, data in plain:
        for index, slot in texture.uses:
            info = gltf.info_of(made["materials"][index], slot)
            if info is None:
                raise AssertionError(f"{slot} of material {index} has been read")
            wants.append(Want(info, info["index"], textures[info["index"]].get("sampler"), data))
    return wants


def _of_map(document: Document, bake: GltfBake, index: int, material: Json, slot: str, data: bytes) -> list[Want]:
    """The textureInfos of a material that a slot's map is for; those that it lacked are made."""
    textures = document.all("textures")
    before, lobe = document.all("materials")[index], bake.lobe
    main = gltf.info_of(before, lobe.normal) or gltf.info_of(before, lobe.roughness)
    if main is None:
        raise AssertionError(f"material {index} has something to bake")
    holder = gltf.made_holder(material, slot)
    info = gltf.info_of(material, slot)
    shown = None if info is None else info["index"]
    sampler = textures[main["index"] if shown is None else shown].get("sampler")
    if info is None or slot == gltf.ANISOTROPIC:
        holder[slot] = info = {"index": shown, **gltf.surface_mapping(main)}
    wants = [Want(info, shown, sampler, data)]
    red = gltf.info_of(material, lobe.red)
    if slot == lobe.roughness and shown is not None and red and bake.options.maps.get("occlusion"):
        images = {stored_image(document, source_of(document, t, slot), slot)[0] for t in (shown, red["index"])}
        if len(images) == 1:
            wants.append(Want(red, red["index"], textures[red["index"]].get("sampler"), data))
    return wants


def _set_factors(material: Json, result: GltfResult) -> None:
    """Makes 1 of what the maps hold already, or what brings the values of stretched maps back. A factor that is not
    there is 1 by itself; an anisotropy that the bake took in and no map holds is taken away."""
    maps, lobe = result.maps, result.bake.lobe
    if lobe.roughness in maps:
        holder = gltf.made_holder(material, lobe.roughness)
        for (key, default), value in zip(lobe.factors, (result.ranges.roughness, 1), strict=False):
            _set(holder, key, default, value)
    if gltf.ANISOTROPIC in maps:
        holder = gltf.made_holder(material, gltf.ANISOTROPIC)
        holder |= {"anisotropyStrength": 1, "anisotropyRotation": 0}
    elif maps and "anisotropy" in result.bake.options.maps:
        del material["extensions"][gltf.ANISOTROPY]
        if not material["extensions"]:
            del material["extensions"]


def _set(holder: Json, key: str, default: float, value: float) -> None:
    """Sets a factor, unless it is that value already or by default."""
    if holder.get(key, default) != value:
        holder[key] = 1 if value == 1 else value
