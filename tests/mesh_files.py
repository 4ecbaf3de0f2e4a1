"""Meshes for tests, and files of them in OBJ and glTF 2.0, written by hand."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.mesh import Mesh

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
SHAPES = [shapes.plane(), shapes.sphere(8), shapes.material_ball(4)]

QUAD = {  # in the plane z = 0, u along +x, upright in the image
    "POSITION": np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], np.float32),
    "NORMAL": np.tile(np.float32([0, 0, 1]), (4, 1)),
    "TEXCOORD_0": np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32),
}
CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)


class Gltf:
    """The JSON and the bytes of a glTF file that grows accessor by accessor."""

    def __init__(self) -> None:
        self.data = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
        self.json |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": []}], "accessors": [], "bufferViews": []}

    def view(self, data: bytes, **options: Any) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **options})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: NDArray[Any], **options: Any) -> int:
        rows = values.reshape(len(values), -1)
        accessor = {"componentType": CODES[rows.dtype.str[1:]], "count": len(rows), "type": TYPES[rows.shape[1]]}
        view = {} if "bufferView" in options else {"bufferView": self.view(rows.tobytes())}
        self.json["accessors"].append({**accessor, **view, **options})
        return len(self.json["accessors"]) - 1

    def primitive(self, attributes: dict[str, NDArray[Any]], corners: NDArray[Any] | None, **options: Any) -> None:
        found: dict[str, Any] = {"attributes": {name: self.accessor(each) for name, each in attributes.items()}}
        bounds = {name: getattr(attributes["POSITION"], name)(0).tolist() for name in ("min", "max")}
        self.json["accessors"][found["attributes"]["POSITION"]] |= bounds
        if corners is not None:
            found["indices"] = self.accessor(corners)
        self.json["meshes"][0]["primitives"].append({**found, **options})

    def write(self, path: Path, kind: str = "glb") -> Path:
        buffer: dict[str, Any] = {"byteLength": len(self.data)}
        self.json["buffers"] = [buffer]
        if kind == "external":
            (path.parent / "the data.bin").write_bytes(self.data)
            buffer["uri"] = "the%20data.bin"
        elif kind == "embedded":
            buffer["uri"] = "data:application/gltf-buffer;base64," + base64.b64encode(self.data).decode()
        text = json.dumps(self.json).encode()
        if kind != "glb":
            path = path.with_suffix(".gltf")
            path.write_bytes(text)
            return path
        chunks = b""
        for name, plain, pad in ((b"JSON", text, b" "), (b"BIN\0", self.data, b"\0")):
            data = plain + pad * (-len(plain) % 4)
            chunks += struct.pack("<I4s", len(data), name) + data
        path = path.with_suffix(".glb")
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def quad(**options: Any) -> Gltf:
    made = Gltf()
    made.primitive(QUAD, CORNERS, **options)
    return made


def attributes_of(mesh: Mesh) -> dict[str, NDArray[np.float32]]:
    arrays = {"POSITION": mesh.positions, "NORMAL": mesh.normals, "TEXCOORD_0": mesh.uv, "TANGENT": mesh.tangents}
    return {name: each.astype(np.float32) for name, each in arrays.items()}


def obj_text(mesh: Mesh, normals: bool = True) -> str:
    lines = ["# a comment", "mtllib none.mtl", "o thing"]
    lines += ["v " + " ".join(map(repr, p)) for p in mesh.positions.tolist()]
    lines += [f"vt {u!r} {1 - v!r}" for u, v in mesh.uv.tolist()]
    lines += ["vn " + " ".join(map(repr, n)) for n in mesh.normals.tolist()]
    corner = "{0}/{0}/{0}" if normals else "{0}/{0}"
    lines += ["f " + " ".join(corner.format(i + 1) for i in triangle) for triangle in mesh.triangles.tolist()]
    return "\n".join(lines)


def by_corner(mesh: Mesh) -> NDArray[np.float64]:
    """(T, 3, 12): all of a vertex, at each corner."""
    return np.concatenate([mesh.positions, mesh.normals, mesh.uv, mesh.tangents], -1)[mesh.triangles]


def same(found: Mesh, expected: Mesh, tolerance: float = 1e-12) -> None:
    assert np.abs(by_corner(found) - by_corner(expected)).max() < tolerance
