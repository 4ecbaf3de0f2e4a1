"""Meshes in OBJ files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mipbake.base.errors import InputError
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.comparing.meshes.tangents import with_tangents

from .mesh_files import SHAPES, obj_text, same


def generated(mesh: Mesh) -> Mesh:
    return with_tangents("same", mesh.positions, mesh.normals, mesh.uv, mesh.triangles)


@pytest.mark.parametrize("mesh", SHAPES, ids=lambda m: m.name)
def test_shapes_come_back_from_obj(mesh: Mesh, tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    path.write_text(obj_text(mesh))
    found = read_mesh(path)
    same(found, generated(mesh))
    assert found.name == "mesh.obj" and len(found.positions) <= 1.1 * len(mesh.positions)


def test_obj_polygons_relative_indices_and_long_lines(tmp_path: Path) -> None:
    path = tmp_path / "MESH.OBJ"
    path.write_text(
        "v 0 0 0\nv 2 0 0\nv 2 1 0 0.5 0.5 0.5\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1 0\nvt 0 1\nvn 0 0 5\n"
        "f -4/-4/-1 -3/-3/1 \\\n -2/-2/1 -1/4/-1 # the quad above\n"
        "v 0 0 3\nv 1 0 3\nv 1 1 3\nl 1 2\nf -3/1/1 -2/2/1 -1/3/1\r\n"
    )
    found = read_mesh(path)
    p = found.positions[found.triangles]
    area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2] / 2
    assert sorted(zip(p[:, 0, 2], area, strict=True)) == [(0, 1), (0, 1), (3, 0.5)]
    assert np.allclose(found.normals, [0, 0, 1]) and np.allclose(found.tangents, [1, 0, 0, 1])
    assert np.allclose(found.uv[:, 1], 1 - found.positions[:, 1])


@pytest.mark.parametrize("turned", [False, True])
def test_concave_polygons_are_cut_inside_their_outline(turned: bool, tmp_path: Path) -> None:
    # An arrow head, a U, a comb, and a square with a bridge to a hole, in a plane that faces +x, or -x when turned.
    outlines = [
        [(0, 0), (2, -1), (1, 0), (2, 1)],
        [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)],
        [(0, 0), (5, 0), (5, 2), (4, 2), (4, 1), (3, 1), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)],
        [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)],
    ]
    areas = [1, 7, 8, 12]
    for outline, expected in zip(outlines, areas, strict=True):
        for start in range(len(outline)):
            points = outline[start:] + outline[:start]
            points = points[::-1] if turned else points
            text = "".join(f"v 7 {y} {z}\nvt {y} {z}\n" for y, z in points)
            (tmp_path / "x.obj").write_text(text + "f " + " ".join(f"{i}/{i}" for i in range(1, len(points) + 1)))
            found = read_mesh(tmp_path / "x.obj")
            p = found.positions[found.triangles]
            area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 0] / 2 * (-1 if turned else 1)
            assert len(area) == len(points) - 2
            # Pieces that all face one way and add up to the area cannot leave the outline.
            assert area.min() >= 0 and area.sum() == pytest.approx(expected)
            assert np.allclose(found.normals, [-1 if turned else 1, 0, 0])


def test_obj_without_normals_is_smooth_but_for_its_edges(tmp_path: Path) -> None:
    ball = shapes.sphere(24)
    (tmp_path / "ball.obj").write_text(obj_text(ball, normals=False))
    found = read_mesh(tmp_path / "ball.obj")
    assert (found.normals * found.positions).sum(-1).min() > 0.997
    assert len(found.positions) <= 1.1 * len(ball.positions)
    # A cube of quads: flat sides.
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    sides = [[i for i, p in enumerate(corners) if p[a] == s] for a in range(3) for s in (-1, 1)]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    for a, b, c, d in sides:
        text += f"f {a + 1}/1 {b + 1}/2 {d + 1}/3 {c + 1}/4\n"
    (tmp_path / "cube.obj").write_text(text)
    found = read_mesh(tmp_path / "cube.obj")
    assert np.allclose(np.abs(found.normals).max(-1), 1) and len(found.positions) == 24


OBJ_ERRORS = {
    "no triangles": ("v 0 0 0\nv 1 0 0\n", "has no triangles: expected lines that begin with f"),
    "no uv": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no texture coordinates in line 4: .* unwrap"),
    "nan": ("v 0 nan 0\n", "line 1 .* gives a position as '0 nan 0': expected three finite numbers"),
    "word": ("vt here\n", "line 1 .* texture coordinate as 'here': expected one to three"),
    "two corners": ("v 0 0 0\nvt 0 0\nf 1/1 1/1\n", "line 3 .* has 2 corners, expected at least 3"),
    "beyond": ("v 0 0 0\nvt 0 0\nf 1/1 1/1 2/1\n", "line 3 .* a position with number 2 of 1"),
    "uv beyond": ("v 0 0 0\nvt 0 0\nf 1/1 1/1 1/7\n", "line 3 .* a texture coordinate with number 7 of 1"),
    "before": ("v 0 0 0\nvt 0 0\nf 1/1 1/1 -2/1\n", "line 3 .* has the corner '-2/1'"),
    "huge": ("v 0 0 0\nvt 0 0\nf 1/1 99999999999999999999/1 1/1\n", "line 3 .* has the corner '9999"),
    "letters": ("v 0 0 0\nvt 0 0\nf 1/1 a/1 1/1\n", "line 3 .* has the corner 'a/1'"),
}


@pytest.mark.parametrize("name", OBJ_ERRORS)
def test_a_bad_obj_is_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    text, message = OBJ_ERRORS[name]
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_mesh(tmp_path / "bad.obj")
    assert "bad.obj" in str(error.value) and "\n" not in str(error.value)


def test_files_that_are_no_meshes_are_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "folder.glb").mkdir()
    (tmp_path / "mesh.fbx").write_text("")
    (tmp_path / "noise.obj").write_bytes(bytes(range(256)) * 4)
    for name, message in (
        ("none.obj", r"none\.obj cannot be read \(No such file or directory\): expected a mesh"),
        ("folder.glb", r"folder\.glb is a folder"),
        ("mesh.fbx", r"ends in \.obj, \.gltf, \.glb, so convert it to glTF"),
        ("noise.obj", "no triangles"),
    ):
        with pytest.raises(InputError, match=message):
            read_mesh(tmp_path / name)
