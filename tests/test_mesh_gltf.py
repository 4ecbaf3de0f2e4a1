"""Meshes in glTF 2.0 files."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_file import read_mesh

from .mesh_files import CORNERS, QUAD, SHAPES, Gltf, attributes_of, quad, same


@pytest.mark.parametrize("mesh", SHAPES, ids=lambda m: m.name)
def test_shapes_come_back_from_gltf_with_their_tangents_to_the_last_bit(mesh: Mesh, tmp_path: Path) -> None:
    made = Gltf()
    stored = attributes_of(mesh)
    made.primitive(stored, mesh.triangles.astype(np.uint32).reshape(-1))
    found = read_mesh(made.write(tmp_path / "mesh", "external"))
    assert np.array_equal(found.triangles, mesh.triangles)
    for name, array in zip(stored, (found.positions, found.normals, found.uv, found.tangents), strict=True):
        assert np.array_equal(array, stored[name])


def test_what_a_gltf_lacks_is_made_as_it_prescribes(tmp_path: Path) -> None:
    made = Gltf()
    without = {name: each for name, each in QUAD.items() if name != "NORMAL"}
    made.primitive({**without, "TANGENT": np.tile(np.float32([0, 1, 0, 1]), (4, 1))}, CORNERS)  # no use without normals
    found = read_mesh(made.write(tmp_path / "x"))
    assert np.allclose(found.normals, [0, 0, 1]) and np.allclose(found.tangents, [1, 0, 0, 1])
    ball = shapes.sphere(6)
    made = Gltf()
    made.primitive(
        {"POSITION": ball.positions.astype("f4"), "TEXCOORD_0": ball.uv.astype("f4")},
        ball.triangles.astype("u2").ravel(),
    )
    found = read_mesh(made.write(tmp_path / "x"))
    p = found.positions[found.triangles]
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
    assert np.allclose(found.normals[found.triangles], flat[:, None], atol=1e-6)
    # Vectors of no length, which exporters write where a triangle has no area, are replaced by unit vectors.
    lame = {**QUAD, "NORMAL": QUAD["NORMAL"].copy(), "TANGENT": np.tile(np.float32([1, 0, 0, -1]), (4, 1))}
    lame["NORMAL"][0] = lame["TANGENT"][1, :3] = 0
    made = Gltf()
    made.primitive(lame, CORNERS)
    found = read_mesh(made.write(tmp_path / "x"))
    assert np.allclose(found.normals, [0, 0, 1])
    assert np.allclose(np.linalg.norm(found.tangents[:, :3], axis=-1), 1) and not found.tangents[:, 2].any()
    assert (found.tangents[:, 3] == -1).all()


def test_strips_fans_and_meshes_without_indices(tmp_path: Path) -> None:
    def read(corners: Sequence[int] | None, order: Sequence[int] = (0, 1, 2, 3), **options: Any) -> Any:
        made = Gltf()
        attributes = {name: each[list(order)] for name, each in QUAD.items()}
        made.primitive(attributes, None if corners is None else np.array(corners, np.uint8), **options)
        found = read_mesh(made.write(tmp_path / "x"))
        p = found.positions[found.triangles]
        area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2] / 2
        assert np.allclose(area, 1)  # counter-clockwise, and no triangle twice
        return found.triangles.tolist()

    assert read([0, 1, 3, 2], mode=5) == [[0, 1, 3], [1, 2, 3]]
    assert read([0, 1, 2, 3], mode=6) == [[1, 2, 0], [2, 3, 0]]
    assert read(None, (0, 1, 3, 2), mode=5) == [[0, 1, 2], [1, 3, 2]]
    assert read(None, (0, 1, 2, 0, 2, 3, 0)) == [[0, 1, 2], [3, 4, 5]]  # the last corner is one too many
    made = quad()
    made.primitive(QUAD, CORNERS, mode=1)  # lines
    assert len(read_mesh(made.write(tmp_path / "x")).triangles) == 2


BOUNDS = {"min": [0, 0, 0], "max": [2, 1, 0]}  # of the quad's positions


def test_strided_sparse_and_integer_accessors(tmp_path: Path) -> None:
    plain = read_mesh(quad().write(tmp_path / "plain"))
    # All attributes interleaved in one view; texture coordinates as normalised bytes, normals as normalised shorts.
    made = Gltf()
    kinds = {"POSITION": "f4", "NORMAL": "i2", "TEXCOORD_0": "u1"}
    scale = {"f4": 1, "i2": 32767, "u1": 255}
    rows = [(QUAD[name] * scale[kind]).astype(kind) for name, kind in kinds.items()]
    data = b"".join(b"".join(each[i].tobytes().ljust(12, b"\x7f") for each in rows) for i in range(4))
    view = made.view(data, byteStride=36)
    for i, (name, each) in enumerate(zip(kinds, rows, strict=True)):
        made.accessor(each, bufferView=view, byteOffset=12 * i, normalized=each.dtype.kind != "f")
        assert made.json["accessors"][-1]["type"] == ("VEC2" if name == "TEXCOORD_0" else "VEC3")
    made.json["accessors"][0] |= BOUNDS
    indices = made.accessor(CORNERS)
    made.json["meshes"][0]["primitives"] = [{"attributes": dict(zip(kinds, range(3), strict=True)), "indices": indices}]
    made.json["extensionsUsed"] = made.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    same(read_mesh(made.write(tmp_path / "strided")), plain)
    # Positions of zeros, replaced one by one; and quantised ones, which are scaled by their node.
    made = quad()
    places, values = np.array([1, 2, 3], np.uint8), QUAD["POSITION"][1:].copy()
    sparse = {"count": 3, "indices": {"bufferView": made.view(places.tobytes()), "componentType": 5121}}
    sparse["values"] = {"bufferView": made.view(values.tobytes())}
    made.json["accessors"][0] = {"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse, **BOUNDS}
    same(read_mesh(made.write(tmp_path / "sparse")), plain)
    made.json["accessors"][0] |= {"bufferView": 0, "max": [4, 1, 0]}
    values[:] = [[4, 0, 0], [4, 1, 0], [0, 1, 0]]
    made.data = made.data[: -values.nbytes] + values.tobytes()
    assert read_mesh(made.write(tmp_path / "sparse")).positions[:, 0].tolist() == [0, 4, 4, 0]
    made = quad()
    small = np.pad(QUAD["POSITION"] * 50, ((0, 0), (0, 1))).astype(np.int8)
    view = {"bufferView": made.view(small.tobytes(), byteStride=4), "componentType": 5120}
    made.json["accessors"][0] |= {**view, "max": [100, 50, 0]}
    made.json |= {"nodes": [{"mesh": 0, "scale": [1 / 50] * 3}], "extensionsRequired": ["KHR_mesh_quantization"]}
    made.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    same(read_mesh(made.write(tmp_path / "quantised")), plain)


def frames(mesh: Mesh) -> NDArray[np.float64]:
    """(V, 3, 3): tangent, bitangent and normal."""
    t, n = mesh.tangents[:, :3], mesh.normals
    return np.stack([t, np.cross(n, t) * mesh.tangents[:, 3:], n], 1)


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 0.5, -3)])
def test_nodes_move_turn_and_mirror_with_right_frames(scale: tuple[float, float, float], tmp_path: Path) -> None:
    a, b = 0.7, np.array([0.2, 0.5, -0.3])
    quaternion = [*(np.sin(a / 2) * b / np.linalg.norm(b)), np.cos(a / 2)]
    inner = np.array([[0, -1, 0, 3], [1, 0, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1.0]])
    made = Gltf()
    ball = shapes.sphere(3)
    attributes = attributes_of(ball)
    made.primitive(attributes, ball.triangles.astype(np.uint32).ravel())
    made.json["nodes"] = [
        {"children": [1], "translation": [1, 2, 3], "rotation": quaternion, "scale": list(scale)},
        {"mesh": 0, "matrix": inner.T.ravel().tolist()},
        {"mesh": 0, "scale": [0, 0, 0]},  # hidden
    ]
    made.json["scenes"] = [{"nodes": [2]}, {"nodes": [0, 2]}]
    made.json["scene"] = 1
    found = read_mesh(made.write(tmp_path / "x"))

    k = b / np.linalg.norm(b)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    rotation = np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross  # Rodrigues
    matrix = (rotation * scale) @ inner[:3, :3]
    assert np.allclose(found.positions, ball.positions @ matrix.T + (rotation * scale) @ inner[:3, 3] + [1, 2, 3])
    # Normals stay normal to the surface and outside; the bitangent goes where the transform takes it.
    p = found.positions[found.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert ((face[:, None] * found.normals[found.triangles]).sum(-1) > 0).mean() > 0.99
    before, after = frames(ball), frames(found)
    assert np.allclose(np.linalg.norm(after, axis=-1), 1, atol=1e-6)
    assert np.allclose((after[:, 0] * after[:, 2]).sum(-1), 0, atol=1e-6)
    moved = before @ matrix.T
    assert ((after[:, 0] * moved[:, 0]).sum(-1) > 0).all() and ((after[:, 1] * moved[:, 1]).sum(-1) > 0).all()
    assert (np.sign(found.tangents[:, 3]) == np.sign(np.prod(scale))).all()


def test_a_mesh_stands_where_every_node_puts_it_and_a_skin_leaves_it(tmp_path: Path) -> None:
    made = quad()
    made.primitive(QUAD, CORNERS)
    made.json["nodes"] = [{"children": [1, 2]}, {"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0, "skin": 0}]
    made.json["nodes"][2]["translation"] = [0, 0, 9]
    made.json["skins"] = [{"joints": [0]}]
    del made.json["scenes"], made.json["scene"]
    found = read_mesh(made.write(tmp_path / "x"))
    assert len(found.triangles) == 8 and found.bounds()[0].tolist() == [0, 0, 0]
    assert found.bounds()[1].tolist() == [7, 1, 0]


def changed(change: Callable[[dict[str, Any]], Any]) -> Gltf:
    made = quad()
    change(made.json)
    return made


def without_uv() -> Gltf:
    made = Gltf()
    made.primitive({name: each for name, each in QUAD.items() if name != "TEXCOORD_0"}, CORNERS)
    return made


def with_nan() -> Gltf:
    made = Gltf()
    normals = QUAD["NORMAL"].copy()
    normals[2, 1] = np.nan
    made.primitive({**QUAD, "NORMAL": normals}, CORNERS)
    return made


def draco_alone(json: dict[str, Any]) -> None:
    json["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    del json["accessors"][0]["bufferView"]


def change(array: str, index: int, **members: Any) -> Gltf:
    return changed(lambda j: j[array][index].update(members))


GLTF_ERRORS = {
    "no triangles": (changed(lambda j: j["meshes"][0]["primitives"][0].update(mode=0)), "no triangles in its default"),
    "no uv": (without_uv(), "primitive 0 of mesh 0 of .* no texture coordinates: .*TEXCOORD_0, so unwrap"),
    "nan": (with_nan(), "not finite in NORMAL at vertex 2"),
    "draco alone": (changed(draco_alone), "with Draco.*transform cp"),
    "meshopt": (changed(lambda j: j.update(extensionsRequired=["EXT_meshopt_compression"])), "with meshopt"),
    "extension": (changed(lambda j: j.update(extensionsRequired=["EXT_mesh_gpu"])), "requires .* EXT_mesh_gpu, which"),
    "index": (change("accessors", 3, count=6, bufferView=9), "accessor 3 names 9 of its 4"),
    "vertex": (change("accessors", 0, count=3), "indices of primitive 0 of mesh 0 do not lead"),
    "count": (change("accessors", 1, count=3), "has 3 values of NORMAL for 4 vertices"),
    "kind": (change("accessors", 2, type="VEC3"), "of the type VEC3, expected VEC2"),
    "component": (change("accessors", 0, componentType=5124), "components of the type 5124"),
    "short view": (change("accessors", 0, count=5), "accessor 0 needs 60 bytes of a buffer view"),
    "types": (change("accessors", 0, count="four"), "broken"),
    "no objects": (changed(lambda j: j["meshes"].__setitem__(0, 7)), "broken .its objects are not as glTF defines"),
    "loop": (change("nodes", 0, children=[0]), "node 0 is in the scene twice"),
    "transform": (change("nodes", 0, rotation=[1e200, 0, 0, 1e200]), "transform of node 0 is"),
}


@pytest.mark.parametrize("name", GLTF_ERRORS)
def test_a_bad_gltf_is_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    made, message = GLTF_ERRORS[name]
    with pytest.raises(InputError, match=message) as error:
        read_mesh(made.write(tmp_path / "bad"))
    assert "bad.glb" in str(error.value) and "\n" not in str(error.value)


def test_a_gltf_without_its_data_is_refused_in_a_sentence(tmp_path: Path) -> None:
    """The sentences of every reader of documents are in test_gltf_document.py."""
    path = quad().write(tmp_path / "y", "external")
    compressed = {"byteLength": 140, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
    for buffer, message in (({"byteLength": 140}, "buffer 0 has no data"), (compressed, "compressed with meshopt")):
        path.write_text(json.dumps(quad().json | {"buffers": [buffer]}))
        with pytest.raises(InputError, match=message):
            read_mesh(path)
