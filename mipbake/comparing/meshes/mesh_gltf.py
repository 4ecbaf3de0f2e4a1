"""Meshes of glTF 2.0 files and GLBs, read through the document that materials are read through too."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.comparing.meshes.mesh import Mesh, joined
from mipbake.comparing.meshes.tangents import any_tangent, corner_normals, unit, with_tangents
from mipbake.source.gltf.document import Document, Json, read_document

Array = NDArray[np.float64]

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6

_COMPRESSED = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}
_HARMLESS = re.compile(r"KHR_mesh_quantization|[A-Z]+_(materials|texture|lights|xmp|animation)(_\w+)?")
"""Extensions that a file may require: those that leave positions, normals, tangents and TEXCOORD_0 alone."""

_MALFORMED = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""What reading objects as glTF can raise when they are not glTF: values of the wrong type, missing or out of place."""


def read_gltf(path: Path) -> Mesh:
    """The triangles of the default scene (the first, where none is named), in the world.

    Normals that the file lacks are flat, as glTF prescribes. TANGENT is taken as it is, w included; tangents that the
    file lacks, or brings without normals, are generated (`mipbake.comparing.meshes.tangents`), and vectors of no length
    replaced. A node that mirrors turns w and the winding. Skins and morph targets are not applied, points and lines
    passed over; texture coordinates are TEXCOORD_0, without KHR_texture_transform. Errors are those of `read_mesh`.
    """
    document = read_document(path)
    for name in document.json.get("extensionsRequired", []):
        if name in _COMPRESSED:
            raise _compressed(path, name)
        if not _HARMLESS.fullmatch(name):
            raise InputError(
                f"the mesh {path} requires the glTF extension {name}, which is not read: expected plain triangles, so "
                "export it without"
            )
    try:
        return _Scene(document).mesh()
    except _MALFORMED as error:
        said = " ".join(str(error).split()) if isinstance(error, ValueError) else ""
        reason = said or "its objects are not as glTF defines them"
        raise InputError(
            f"the mesh {path} is broken ({reason}): expected valid glTF 2.0, so check it with the glTF validator and "
            "export it again"
        ) from error


def _compressed(path: Path, extension: str) -> InputError:
    return InputError(
        f"the mesh {path} is compressed with {_COMPRESSED[extension]}, which is not read: expected plain glTF, so "
        "decompress it (`gltf-transform cp IN.glb OUT.glb`) or export it without compression"
    )


class _Scene:
    """A file's objects, resolved: indices to arrays of numbers, nodes to meshes in the world."""

    def __init__(self, document: Document) -> None:
        self.document, self.path = document, document.path
        self.local = lru_cache(None)(self._local)

    def mesh(self) -> Mesh:
        waiting = [(index, np.eye(4), "the scene") for index in self._roots()]
        found, seen = [], set()
        while waiting:
            index, parent, where = waiting.pop(0)
            node = self.document.one("nodes", index, where)
            if index in seen:
                raise ValueError(f"node {index} is in the scene twice")
            seen.add(index)
            with np.errstate(over="ignore", invalid="ignore"):  # it is refused in the next line
                matrix = parent @ _matrix(node)
            if not np.isfinite(matrix).all():
                raise ValueError(f"the transform of node {index} is not finite")
            waiting += [(child, matrix, f"node {index}") for child in node.get("children", [])]
            if "mesh" in node:
                # A skinned mesh takes no transform of its node.
                placed = np.eye(4) if "skin" in node else matrix
                found += [_placed(each, placed) for each in self.local(node["mesh"]) if _has_volume(placed)]
        if not found:
            raise InputError(
                f"the mesh {self.path} has no triangles in its default scene: expected at least one, so export polygons"
            )
        return joined(self.path.name, found)

    def _roots(self) -> list[int]:
        if self.document.all("scenes"):
            scene = self.document.one("scenes", self.document.json.get("scene", 0), "the file")
            return list(scene.get("nodes", []))
        nodes = self.document.all("nodes")
        children = {child for node in nodes for child in node.get("children", [])}
        return [index for index in range(len(nodes)) if index not in children]

    def _local(self, index: int) -> list[Mesh]:
        """The primitives of a mesh that are made of triangles, untransformed."""
        mesh = self.document.one("meshes", index, "a node")
        name = f"mesh {index}" + (f" ({mesh['name']})" if mesh.get("name") else "")
        read = (self._primitive(f"primitive {i} of {name}", each) for i, each in enumerate(mesh["primitives"]))
        return [each for each in read if each is not None]

    def _primitive(self, where: str, primitive: Json) -> Mesh | None:
        mode, attributes = primitive.get("mode", _TRIANGLES), primitive["attributes"]
        if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
            return None
        draco = "KHR_draco_mesh_compression"
        position = self.document.one("accessors", attributes["POSITION"], f"POSITION of {where}")
        if "bufferView" not in position and draco in primitive.get("extensions", {}):
            raise _compressed(self.path, draco)
        positions = self._attribute(where, "POSITION", attributes["POSITION"], "VEC3", None)
        count = len(positions)
        if "indices" not in primitive:
            corners = np.arange(count)
        else:
            corners = self.accessor(primitive["indices"], "SCALAR", f"the indices of {where}")[:, 0]
            if corners.dtype.kind != "u" or (len(corners) and corners.max() >= count):
                raise ValueError(f"the indices of {where} do not lead to its {count} vertices")
        triangles = _triangles(corners.astype(np.int32), mode)
        if not len(triangles):
            return None
        if "TEXCOORD_0" not in attributes:
            raise InputError(
                f"{where} of {self.path} has no texture coordinates: expected the attribute TEXCOORD_0, so unwrap the "
                "mesh and export it with UVs"
            )
        uv = self._attribute(where, "TEXCOORD_0", attributes["TEXCOORD_0"], "VEC2", count)
        if "NORMAL" not in attributes:
            flat = corner_normals(positions, triangles, 0).reshape(-1, 3)
            corner = triangles.reshape(-1)
            apart = np.arange(len(corner), dtype=np.int32).reshape(-1, 3)
            return with_tangents(where, positions[corner], flat, uv[corner], apart)
        normals = self._attribute(where, "NORMAL", attributes["NORMAL"], "VEC3", count)
        normals = _unit(normals)
        lost = ~normals.any(-1)
        if lost.any():
            smooth = np.zeros_like(normals)
            smooth[triangles] = corner_normals(positions, triangles, 180)
            normals[lost] = np.where(smooth.any(-1, keepdims=True), smooth, [0.0, 1.0, 0.0])[lost]
        if "TANGENT" not in attributes:
            return with_tangents(where, positions, normals, uv, triangles)
        tangents = self._attribute(where, "TANGENT", attributes["TANGENT"], "VEC4", count)
        if (tangents[:, 3] == 0).any():
            raise ValueError(f"the handedness of a tangent of {where} is 0")
        along = _unit(tangents[:, :3])
        lost = ~along.any(-1)
        along[lost] = any_tangent(normals[lost])
        tangents = np.concatenate([along, np.sign(tangents[:, 3:])], -1)
        return Mesh(where, positions, normals, uv, tangents, triangles)

    def _attribute(self, where: str, name: str, index: int, kind: str, count: int | None) -> Array:
        values = self.accessor(index, kind, f"{name} of {where}").astype(np.float64)
        if count is not None and len(values) != count:
            raise ValueError(f"{where} has {len(values)} values of {name} for {count} vertices")
        wrong = ~np.isfinite(values).all(-1)
        if wrong.any():
            raise InputError(
                f"{where} of {self.path} holds a value that is not finite in {name} at vertex {int(wrong.argmax())}: "
                "expected numbers, so clean the mesh up and export it again"
            )
        return values

    def accessor(self, index: int, kind: str, where: str) -> NDArray[Any]:
        """(count, width): integers as they are, normalised ones as float64, floats as float32."""
        accessor = self.document.one("accessors", index, where)
        if accessor["type"] != kind:
            raise ValueError(f"accessor {index} is of the type {accessor['type']}, expected {kind}")
        count, dtype, width = _count(accessor["count"]), _dtype(accessor["componentType"]), _WIDTHS[kind]
        name = f"accessor {index}"
        if "bufferView" in accessor:
            values = self._view(accessor, count, width, dtype, name)
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            sparse, name = accessor["sparse"], f"the sparse part of {name}"
            places, some = sparse["indices"], _count(sparse["count"])
            at = self._view(places, some, 1, _dtype(places["componentType"]), name)
            values = values.copy()
            values[at[:, 0]] = self._view(sparse["values"], some, width, dtype, name)
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    def _view(self, holder: Json, count: int, width: int, dtype: np.dtype[Any], where: str) -> NDArray[Any]:
        """(count, width) values of the buffer view that an accessor, or a part of a sparse one, names: from its offset
        on, as far apart as the view says, and without a copy, because many accessors may share one view."""
        view = self.document.one("bufferViews", holder["bufferView"], where)
        size = width * dtype.itemsize
        stride, offset = _count(view.get("byteStride", size)), _count(holder.get("byteOffset", 0))
        needed = offset + (stride * (count - 1) + size if count else 0)
        if needed > view["byteLength"]:
            raise ValueError(f"{where} needs {needed} bytes of a buffer view that holds {view['byteLength']}")
        data, start = self._buffer(view["buffer"]), view.get("byteOffset", 0) + offset
        values: NDArray[Any] = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))
        return values

    def _buffer(self, index: int) -> bytes:
        data = self.document.buffers[index]
        if data is None:
            for extension in _COMPRESSED:
                if extension in self.document.all("buffers")[index].get("extensions", {}):
                    raise _compressed(self.path, extension)
            raise ValueError(f"buffer {index} has no data")
        return data


def _count(value: Any) -> int:
    if not isinstance(value, int) or value < 0:
        raise ValueError(f"it gives a number of bytes or of values as {value}")
    return value


def _dtype(component: Any) -> np.dtype[Any]:
    if component not in _COMPONENTS:
        raise ValueError(f"it has components of the type {component}, which is none")
    return np.dtype(_COMPONENTS[component])


def _triangles(corners: NDArray[np.int32], mode: int) -> NDArray[np.int32]:
    """(T, 3), with the winding and the order of glTF 2.0, section 3.7.2.1; corners left over at the end are dropped."""
    if mode in (_STRIP, _FAN):
        i = np.arange(max(len(corners) - 2, 0))
        strip = np.stack([i, i + 1 + i % 2, i + 2 - i % 2], -1)
        return corners[strip if mode == _STRIP else np.stack([i + 1, i + 2, 0 * i], -1)]
    return corners[: len(corners) // 3 * 3].reshape(-1, 3)


def _matrix(node: Json) -> Array:
    """(4, 4) from the node's frame to its parent's, for columns."""
    if "matrix" in node:
        return np.asarray(np.array(node["matrix"], np.float64).reshape(4, 4).T)
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), np.float64)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = rotation * np.array(node.get("scale", [1, 1, 1]), np.float64)
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _has_volume(matrix: Array) -> bool:
    """Whether a transform keeps three dimensions; nodes are hidden by a scale of 0."""
    linear = matrix[:3, :3]
    return bool(abs(np.linalg.det(linear)) > 1e-15 * np.linalg.norm(linear) ** 3)


def _placed(mesh: Mesh, matrix: Array) -> Mesh:
    """The mesh in the world; unchanged to the last bit where the transform changes nothing."""
    linear = matrix[:3, :3]
    if np.array_equal(matrix, np.eye(4)):
        return mesh
    side = np.sign(np.linalg.det(linear))
    normals = mesh.normals @ np.linalg.inv(linear)
    along = mesh.tangents[:, :3] @ linear.T
    return Mesh(
        mesh.name,
        mesh.positions @ linear.T + matrix[:3, 3],
        normals / np.linalg.norm(normals, axis=-1, keepdims=True),
        mesh.uv,
        np.concatenate([along / np.linalg.norm(along, axis=-1, keepdims=True), mesh.tangents[:, 3:] * side], -1),
        mesh.triangles if side > 0 else np.ascontiguousarray(mesh.triangles[:, ::-1]),
    )


def _unit(vectors: Array) -> Array:
    """Unit vectors as they are, within float32's rounding; others scaled, and 0 where there is no direction."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(np.abs(length - 1) < 1e-6, vectors, unit(vectors))
