"""Meshes for tests, and files of them in OBJ and glTF 2.0, written by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.mesh import Mesh

from .gltf_files import GltfFile

SHAPES = [shapes.plane(), shapes.sphere(8)]

QUAD = {  # in the plane z = 0, u along +x, upright in the image
    "POSITION": np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], np.float32),
    "NORMAL": np.tile(np.float32([0, 0, 1]), (4, 1)),
    "TEXCOORD_0": np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32),
}
CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)


class Gltf(GltfFile):
    """A document of one mesh, without materials."""

    def __init__(self) -> None:
        super().__init__()
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
        self.json |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": []}], "accessors": [], "bufferViews": []}

    def primitive(self, attributes: dict[str, NDArray[Any]], corners: NDArray[Any] | None, **options: Any) -> None:
        found: dict[str, Any] = {"attributes": {name: self.accessor(each) for name, each in attributes.items()}}
        bounds = {name: getattr(attributes["POSITION"], name)(0).tolist() for name in ("min", "max")}
        self.json["accessors"][found["attributes"]["POSITION"]] |= bounds
        if corners is not None:
            found["indices"] = self.accessor(corners)
        self.json["meshes"][0]["primitives"].append({**found, **options})


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
