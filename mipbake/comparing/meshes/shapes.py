"""Meshes made from formulas: a plane and a sphere."""

from __future__ import annotations

import numpy as np

from mipbake.comparing.meshes.mesh import Mesh


def plane(width: float = 2.0, length: float = 2.0, repeat: tuple[float, float] = (1.0, 1.0)) -> Mesh:
    """A rectangle on the ground, y = 0, facing up: u grows along +x over `width`, v along +z over `length`.

    The texture repeats `repeat` times along u and v. Seen from above with -z upwards it stands upright.
    """
    corner = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float64)
    x, z = (corner - 0.5).T * [[width], [length]]
    return Mesh(
        "plane",
        np.stack([x, 0 * x, z], -1),
        np.tile([0.0, 1.0, 0.0], (4, 1)),
        corner * repeat,
        np.tile([1.0, 0.0, 0.0, 1.0], (4, 1)),
        np.array([[0, 2, 1], [1, 2, 3]], np.int32),
    )


def sphere(rows: int = 64, repeat: tuple[float, float] = (2.0, 1.0)) -> Mesh:
    """A sphere of radius 1 around the origin: v from the north pole (+y) to the south, u eastwards from -z.

    `rows` quads from pole to pole, twice as many around. Normals and tangents are the exact ones. The meridian of u = 0
    has its vertices twice, and each triangle at a pole a vertex of its own, whose u is the u of the triangle's middle.
    """
    columns = 2 * rows
    u = np.broadcast_to(np.arange(columns + 1) / columns, (rows + 1, columns + 1)).copy()
    u[[0, -1]] += 0.5 / columns
    v = np.broadcast_to(np.arange(rows + 1)[:, None] / rows, u.shape)
    theta, phi = np.pi * v, 2 * np.pi * u
    n = np.stack([-np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)
    t = np.stack([-np.cos(phi), 0 * phi, np.sin(phi), 1 + 0 * phi], -1)
    # Two triangles for each quad, seen counter-clockwise with rows running down.
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = i * (columns + 1) + j
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    triangles = np.stack([np.stack([a, c, d], -1), np.stack([a, d, b], -1)], -2).astype(np.int32)
    triangles[-1, :, 1, 1] = triangles[-1, :, 0, 1]  # the pole below, with this column's u
    kept = np.ones(triangles.shape[:3], bool)
    kept[0, :, 1] = kept[-1, :, 0] = False  # those that a pole leaves no area
    normals = n.reshape(-1, 3)
    uv = np.stack([u, v], -1).reshape(-1, 2) * repeat
    return Mesh("sphere", normals, normals, uv, t.reshape(-1, 4), triangles[kept])
