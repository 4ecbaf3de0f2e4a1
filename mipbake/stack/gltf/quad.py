"""A GLB of one square that shows a baked material: for texture sets that came from no glTF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mipbake.source.gltf import slots as gltf
from mipbake.source.gltf.document import Json
from mipbake.source.gltf.images import BASISU, KTX2
from mipbake.source.gltf.rewriting import Binary
from mipbake.stack.gltf.ranges import Ranges
from mipbake.stack.gltf.write import finished

_WRAP = {"wrap": 10497, "clamp": 33071}
_LINEAR, _LINEAR_MIPMAP_LINEAR = 9729, 9987
_FLOAT, _UNSIGNED_SHORT = 5126, 5123
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


def standalone(
    name: str,
    maps: Mapping[str, bytes],
    provenance: Mapping[str, Any],
    wrap: tuple[str, str] = ("wrap", "wrap"),
    occlusion: bool = False,
    alpha: Mapping[str, Any] | None = None,
    ranges: Ranges = Ranges(),  # noqa: B008
) -> bytes:
    """A GLB with a square of side 1 in the plane z = 0 that faces +z and shows a material of the same name. The top
    left corner of the images is at (-1/2, 1/2, 0); tangents point along +x, so that green in the normal map is up.

    Args:
        maps, ranges: see `GltfResult`. provenance: JSON values: `asset.extras.mipbake`.
        wrap: addressing along u and v, each "wrap" or "clamp".
        occlusion: whether the red channel of the metallicRoughness map, which is there, is ambient occlusion.
        alpha: `alphaMode`, and `alphaCutoff` for "MASK"; None for an opaque material.
    """
    binary = Binary()
    made: Json = {
        "asset": {"version": "2.0", "generator": "mipbake", "extras": {"mipbake": dict(provenance)}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "materials": [{**_material(name, maps, occlusion, ranges), **(alpha or {})}],
        "buffers": [{}],
        "bufferViews": [],
        "accessors": [],
    }
    _add_square(made, name, binary)
    if maps:
        u, v = (_WRAP[mode] for mode in wrap)
        sampler = {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP_LINEAR, "wrapS": u, "wrapT": v}
        made |= {"samplers": [sampler], "images": [], "textures": []}
    for index, (slot, data) in enumerate(maps.items()):
        made["bufferViews"].append(binary.view(data))
        made["images"].append({"name": slot, "mimeType": KTX2.mime, "bufferView": len(made["bufferViews"]) - 1})
        made["textures"].append({"sampler": 0, "extensions": {BASISU: {"source": index}}})
    extensions = [BASISU] * bool(maps) + [gltf.ANISOTROPY] * (gltf.ANISOTROPIC in maps)
    if extensions:
        made |= {"extensionsUsed": extensions, "extensionsRequired": [BASISU]}
    return finished(made, binary)


def _material(name: str, maps: Mapping[str, bytes], occlusion: bool, ranges: Ranges) -> Json:
    index = {slot: {"index": i} for i, slot in enumerate(maps)}
    packed = gltf.METALLIC_ROUGHNESS in maps
    pbr: Json = {
        "baseColorFactor": [1.0] * 4,
        "metallicFactor": 1 if packed else 0.0,
        "roughnessFactor": ranges.roughness if packed else 1.0,
    }
    pbr |= {slot: index[slot] for slot in (gltf.BASE_COLOUR, gltf.METALLIC_ROUGHNESS) if slot in maps}
    material: Json = {"name": name, "pbrMetallicRoughness": pbr}
    material |= {slot: index[slot] for slot in (gltf.NORMAL, gltf.EMISSIVE) if slot in maps}
    if gltf.NORMAL in maps and ranges.normal != 1:
        material[gltf.NORMAL]["scale"] = ranges.normal
    if gltf.EMISSIVE in maps:
        material["emissiveFactor"] = [1, 1, 1]
    if occlusion:
        material[gltf.OCCLUSION] = dict(index[gltf.METALLIC_ROUGHNESS])
    if gltf.ANISOTROPIC in maps:
        anisotropy = {"anisotropyStrength": 1, "anisotropyRotation": 0, gltf.ANISOTROPIC: index[gltf.ANISOTROPIC]}
        material["extensions"] = {gltf.ANISOTROPY: anisotropy}
    return material


def _add_square(made: Json, name: str, binary: Binary) -> None:
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)  # u, v; v downwards
    positions = np.hstack([corners[:, :1] - 0.5, 0.5 - corners[:, 1:], np.zeros((4, 1), np.float32)])
    attributes = {
        "POSITION": positions,
        "NORMAL": np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        "TANGENT": np.tile(np.array([1, 0, 0, 1], np.float32), (4, 1)),
        "TEXCOORD_0": corners,
        "indices": np.array([0, 3, 2, 0, 2, 1], np.uint16),
    }
    for attribute, values in attributes.items():
        corner = attribute == "indices"
        target = _ELEMENT_ARRAY_BUFFER if corner else _ARRAY_BUFFER
        view = binary.view(values.astype(values.dtype.newbyteorder("<")).tobytes())
        made["bufferViews"].append({**view, "target": target})
        accessor = {"bufferView": len(made["accessors"]), "componentType": _UNSIGNED_SHORT if corner else _FLOAT}
        kind = "SCALAR" if corner else f"VEC{values.shape[1]}"
        made["accessors"].append({**accessor, "count": len(values), "type": kind})
    made["accessors"][0] |= {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    places = {attribute: place for place, attribute in enumerate(attributes)}
    indices = places.pop("indices")
    made["meshes"] = [{"name": name, "primitives": [{"attributes": places, "material": 0, "indices": indices}]}]
