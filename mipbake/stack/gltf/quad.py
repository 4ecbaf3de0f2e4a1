"""A GLB of one square that shows a baked material: for texture sets that came from no glTF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.source.gltf.buffers import Binary
from mipbake.source.gltf.document import Json
from mipbake.source.gltf.images import BASISU, KTX2
from mipbake.source.gltf.slots import (
    ANISOTROPIC,
    ANISOTROPY,
    BASE_COLOUR,
    EMISSIVE,
    METALLIC_ROUGHNESS,
    NORMAL,
    OCCLUSION,
)
from mipbake.source.options import WRAP_MODES
from mipbake.stack.gltf.ranges import Ranges
from mipbake.stack.gltf.write import check_map, finished

SLOTS = (BASE_COLOUR, METALLIC_ROUGHNESS, NORMAL, ANISOTROPIC, EMISSIVE)
ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")

_WRAP = {"wrap": 10497, "clamp": 33071}
_LINEAR, _LINEAR_MIPMAP_LINEAR = 9729, 9987
_FLOAT, _UNSIGNED_SHORT = 5126, 5123
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963


@dataclass(frozen=True)
class QuadOptions:
    """What a material says beside its maps.

    Args:
        wrap: addressing along u and v, each "wrap" or "clamp".
        base_color: red, green, blue, alpha, linear: multiplied with the base colour map, or alone.
        roughness, metallic: where there is no metallicRoughness map.
        occlusion: whether the red channel of the metallicRoughness map is ambient occlusion.
        alpha_mode: "OPAQUE", "MASK" or "BLEND". alpha_cutoff: the cutoff for "MASK".
        double_sided: whether the back is seen.
        ranges: what the material multiplies the values in its maps by.
    """

    wrap: tuple[str, str] = ("wrap", "wrap")
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    roughness: float = 1.0
    metallic: float = 0.0
    occlusion: bool = False
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    ranges: Ranges = field(default_factory=Ranges)

    def __post_init__(self) -> None:
        """UsageError when a value is not in the list."""
        if len(self.wrap) != 2 or any(mode not in WRAP_MODES for mode in self.wrap):
            raise UsageError(f"wrap is {self.wrap!r}: expected two of {', '.join(WRAP_MODES)}")
        if self.alpha_mode not in ALPHA_MODES:
            raise UsageError(f"alpha_mode is {self.alpha_mode!r}: expected one of {', '.join(ALPHA_MODES)}")


def standalone(
    name: str,
    maps: Mapping[str, bytes],
    options: QuadOptions | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> bytes:
    """A GLB with a square of side 1 in the plane z = 0 that faces +z and shows a material.

    The top left corner of the images is at (-1/2, 1/2, 0); tangents point along +x, so that green in the normal map is
    up.

    Args:
        name: of the material and the square.
        maps: slot (one of `SLOTS`) to a complete KTX 2 file, UASTC, sides multiples of 4.
        options: the rest of the material.
        provenance: JSON values: `asset.extras.mipbake`.

    Raises:
        UsageError: an unknown slot, a map that KHR_texture_basisu does not take, or occlusion without its map.
    """
    options = options or QuadOptions()
    for slot, data in maps.items():
        if slot not in SLOTS:
            raise UsageError(f"unknown slot {slot!r} of {name}: expected some of {', '.join(SLOTS)}")
        check_map(name, slot, data)
    if options.occlusion and METALLIC_ROUGHNESS not in maps:
        raise UsageError(f"{name} has no {METALLIC_ROUGHNESS} map whose red channel could be its occlusion")
    binary = Binary()
    made: Json = {
        "asset": {"version": "2.0", "generator": "mipbake", "extras": {"mipbake": dict(provenance or {})}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "materials": [_material(name, maps, options)],
        "buffers": [{}],
    }
    _add_square(made, name, binary)
    _add_textures(made, maps, options, binary)
    extensions = [BASISU] * bool(maps) + [ANISOTROPY] * (ANISOTROPIC in maps)
    if extensions:
        made |= {"extensionsUsed": extensions, "extensionsRequired": [BASISU]}
    return finished(made, binary)


def _material(name: str, maps: Mapping[str, bytes], options: QuadOptions) -> Json:
    index = {slot: {"index": i} for i, slot in enumerate(maps)}
    packed = METALLIC_ROUGHNESS in maps
    pbr: Json = {
        "baseColorFactor": list(options.base_color),
        "metallicFactor": 1 if packed else options.metallic,
        "roughnessFactor": options.ranges.roughness if packed else options.roughness,
    }
    pbr |= {slot: index[slot] for slot in (BASE_COLOUR, METALLIC_ROUGHNESS) if slot in maps}
    material: Json = {"name": name, "pbrMetallicRoughness": pbr}
    material |= {slot: index[slot] for slot in (NORMAL, EMISSIVE) if slot in maps}
    if NORMAL in maps and options.ranges.normal != 1:
        material[NORMAL]["scale"] = options.ranges.normal
    if EMISSIVE in maps:
        material["emissiveFactor"] = [1, 1, 1]
    if options.occlusion:
        material[OCCLUSION] = dict(index[METALLIC_ROUGHNESS])
    if ANISOTROPIC in maps:
        anisotropy = {"anisotropyStrength": 1, "anisotropyRotation": 0, ANISOTROPIC: index[ANISOTROPIC]}
        material["extensions"] = {ANISOTROPY: anisotropy}
    if options.alpha_mode != "OPAQUE":
        material["alphaMode"] = options.alpha_mode
    if options.alpha_mode == "MASK":
        material["alphaCutoff"] = options.alpha_cutoff
    if options.double_sided:
        material["doubleSided"] = True
    return material


def _add_square(made: Json, name: str, binary: Binary) -> None:
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)  # u, v; v downwards
    flat = np.zeros((4, 1), np.float32)
    attributes = {
        "POSITION": np.hstack([corners[:, :1] - 0.5, 0.5 - corners[:, 1:], flat]),
        "NORMAL": np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        "TANGENT": np.tile(np.array([1, 0, 0, 1], np.float32), (4, 1)),
        "TEXCOORD_0": corners,
    }
    made["bufferViews"], made["accessors"] = [], []
    primitive: Json = {"attributes": {}, "material": 0}
    for attribute, values in attributes.items():
        primitive["attributes"][attribute] = len(made["accessors"])
        _view(made, binary, values.astype("<f4").tobytes(), target=_ARRAY_BUFFER)
        accessor = {"bufferView": len(made["bufferViews"]) - 1, "componentType": _FLOAT, "count": 4}
        made["accessors"].append({**accessor, "type": f"VEC{values.shape[1]}"})
    positions = attributes["POSITION"]
    made["accessors"][0] |= {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
    _view(made, binary, np.array([0, 3, 2, 0, 2, 1], "<u2").tobytes(), target=_ELEMENT_ARRAY_BUFFER)
    primitive["indices"] = len(made["accessors"])
    accessor = {"bufferView": len(made["bufferViews"]) - 1, "componentType": _UNSIGNED_SHORT, "count": 6}
    made["accessors"].append({**accessor, "type": "SCALAR"})
    made["meshes"] = [{"name": name, "primitives": [primitive]}]


def _add_textures(made: Json, maps: Mapping[str, bytes], options: QuadOptions, binary: Binary) -> None:
    if not maps:
        return
    u, v = options.wrap
    sampler = {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP_LINEAR, "wrapS": _WRAP[u], "wrapT": _WRAP[v]}
    made |= {"samplers": [sampler], "images": [], "textures": []}
    for slot, data in maps.items():
        _view(made, binary, data)
        image = {"name": slot, "mimeType": KTX2.mime, "bufferView": len(made["bufferViews"]) - 1}
        made["images"].append(image)
        source = {BASISU: {"source": len(made["images"]) - 1}}
        made["textures"].append({"sampler": 0, "extensions": source})


def _view(made: Json, binary: Binary, data: bytes, **others: int) -> None:
    place = {"buffer": 0, "byteOffset": binary.add(data), "byteLength": len(data)}
    made["bufferViews"].append({**place, **others})
