"""A GLB whose squares each show a texture at one level of detail: a row at whole levels, one between them, one lit.

The textures are KTX 2 with UASTC through KHR_texture_basisu, with levels of their own; glTF 2.0, section 4 (GLB).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from engine_textures import EngineMap, level_coloured, uastc
from numpy.typing import NDArray

from mipbake.source.gltf.container import packed

PIXELS = 32
"""Pixels a side of a square in pictures where the grid is seen straight on, a unit of length a square."""

SIDE = 256
"""Texels a side of the level-coloured texture."""

_FLOAT, _SHORT = 5126, 5123
_VERTICES, _INDICES = 34962, 34963
_LINEAR, _LINEAR_LEVELS, _REPEAT = 9729, 9987, 10497


@dataclass
class _Buffer:
    """The binary chunk with its views and accessors."""

    data: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def view(self, data: bytes, target: int | None = None) -> int:
        self.data += bytes(-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        if target is not None:
            self.views[-1]["target"] = target
        self.data += data
        return len(self.views) - 1

    def accessor(self, values: NDArray[np.generic], kind: str) -> int:
        index = kind == "SCALAR"
        accessor = {
            "bufferView": self.view(np.ascontiguousarray(values).tobytes(), _INDICES if index else _VERTICES),
            "componentType": _SHORT if index else _FLOAT,
            "count": len(values),
            "type": kind,
        }
        if kind == "VEC3":
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def lods() -> list[list[float]]:
    """Levels of detail of the squares, by row and column: whole levels, levels between, and the levels of the lit
    row."""
    count = SIDE.bit_length()
    return [[float(c) for c in range(count)], [c + 0.5 for c in range(count)], [float(c) for c in range(count)]]


def squares_glb(baked: Sequence[EngineMap]) -> bytes:
    """The file: two rows with level-coloured unlit squares, a third with the textures `base_color`, `normal`, `orm`."""
    buffer = _Buffer()
    files = [uastc(level_coloured(SIDE, colour=True)), *(uastc(each) for each in baked)]
    images = [{"bufferView": buffer.view(each), "mimeType": "image/ktx2"} for each in files]
    place = {each.name: 1 + index for index, each in enumerate(baked)}
    meshes, nodes = [], []
    for row, of_row in enumerate(lods()):
        side = SIDE if row < 2 else baked[0].levels[0].shape[0]
        for column, lod in enumerate(of_row):
            repeat = PIXELS * 2.0**lod / side
            nodes.append({"mesh": len(meshes), "translation": [column, -row - 1, 0], "name": f"lod {lod:g}, row {row}"})
            meshes.append({"primitives": [_square(buffer, repeat, int(row == 2))]})
    document = {
        "asset": {"version": "2.0", "generator": "mipbake"},
        "extensionsUsed": ["KHR_texture_basisu", "KHR_materials_unlit"],
        "extensionsRequired": ["KHR_texture_basisu"],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [
            {
                "name": "levels",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
                "extensions": {"KHR_materials_unlit": {}},
            },
            {
                "name": "baked",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": place["base_color"]},
                    "metallicRoughnessTexture": {"index": place["orm"]},
                },
                "normalTexture": {"index": place["normal"]},
            },
        ],
        "textures": [
            {"sampler": 0, "extensions": {"KHR_texture_basisu": {"source": index}}} for index in range(len(images))
        ],
        "images": images,
        "samplers": [{"magFilter": _LINEAR, "minFilter": _LINEAR_LEVELS, "wrapS": _REPEAT, "wrapT": _REPEAT}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    return packed(json.dumps(document, separators=(",", ":")).encode(), bytes(buffer.data))


def _square(buffer: _Buffer, repeat: float, material: int) -> dict[str, Any]:
    """A square from (0, 0, 0) to (1, 1, 0), facing +z; v runs down."""
    corner = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)
    x, y = corner.T
    attributes = {
        "POSITION": buffer.accessor(np.stack([x, y, 0 * x], -1), "VEC3"),
        "NORMAL": buffer.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)), "VEC3"),
        "TEXCOORD_0": buffer.accessor(np.stack([x, 1 - y], -1) * np.float32(repeat), "VEC2"),
    }
    if material:  # the other one has no normal map
        attributes["TANGENT"] = buffer.accessor(np.tile(np.float32([1, 0, 0, 1]), (4, 1)), "VEC4")
    indices = buffer.accessor(np.array([0, 1, 2, 2, 1, 3], np.uint16), "SCALAR")
    return {"attributes": attributes, "indices": indices, "material": material}
