"""Meshes made from formulas: a plane, a sphere and a material ball."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes.mesh import Mesh, joined
from mipbake.comparing.meshes.tangents import with_tangents

Array = NDArray[np.float64]


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
    triangles = _grid(rows, columns).reshape(rows, columns, 2, 3)
    triangles[-1, :, 1, 1] = triangles[-1, :, 0, 1]  # the pole below, with this column's u
    kept = np.ones(triangles.shape[:3], bool)
    kept[0, :, 1] = kept[-1, :, 0] = False  # those that a pole leaves no area
    normals = n.reshape(-1, 3)
    uv = np.stack([u, v], -1).reshape(-1, 2) * repeat
    return Mesh("sphere", normals, normals, uv, t.reshape(-1, 4), triangles[kept])


def material_ball(cells: int = 40, repeat: float = 1.0) -> Mesh:
    """A ball of radius 1 around the origin with a recessed ring, on a base: what material libraries show.

    The ball is a cube's six faces blown up, each with the whole texture, `repeat` times along u and v: there is no pole
    where texels crowd. The base is a low drum whose side carries the texture six times around, and whose top carries
    it at the same size. `cells` quads a side of each face.
    """
    return joined("material ball", [*(_ball_face(axis, cells, repeat) for axis in range(6)), *_base(cells, repeat)])


_RING_HEIGHT, _RING_WIDTH, _RING_DEPTH, _RING_EDGE = 0.36, 0.10, 0.07, 0.035  # in units of the ball's radius, radians
_BASE_RADIUS, _BASE_TOP, _BASE_BOTTOM = 0.82, -0.86, -1.12


def _ball_radius(direction: Array) -> Array:
    """Distance of the surface from the centre along (..., 3) unit vectors."""
    latitude = np.arcsin(np.clip(direction[..., 1], -1, 1))
    inside = (_RING_WIDTH - np.abs(latitude - _RING_HEIGHT)) / _RING_EDGE
    step = np.clip(inside, 0, 1)
    return np.asarray(1 - _RING_DEPTH * step * step * (3 - 2 * step))


def _ball_face(face: int, cells: int, repeat: float) -> Mesh:
    """One face of the blown-up cube: +x, -x, +y, -y, +z, -z. Cells of equal angles."""
    axes = np.array(  # right, up (towards smaller v) and outwards
        [
            [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
            [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
            [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
            [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
            [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
        ],
        np.float64,
    )[face]
    v, u = np.meshgrid(np.arange(cells + 1) / cells, np.arange(cells + 1) / cells, indexing="ij")

    def surface(u: Array, v: Array) -> Array:
        local = np.stack([np.tan((u - 0.5) * np.pi / 2), np.tan((0.5 - v) * np.pi / 2), np.ones_like(u)], -1)
        direction = local @ axes
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return np.asarray(direction * _ball_radius(direction)[..., None])

    h = 1e-4
    du, dv = surface(u + h, v) - surface(u - h, v), surface(u, v + h) - surface(u, v - h)
    normals = np.cross(dv, du)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    uv = np.stack([u, v], -1).reshape(-1, 2) * repeat
    return with_tangents("ball", surface(u, v).reshape(-1, 3), normals.reshape(-1, 3), uv, _grid(cells, cells))


def _base(cells: int, repeat: float) -> list[Mesh]:
    """The drum's side, and its top as far as the ball leaves it to be seen; the underside is open."""
    around = 4 * cells
    angle = 2 * np.pi * np.arange(around + 1) / around
    ring = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    height = _BASE_TOP - _BASE_BOTTOM
    side = np.stack([ring * _BASE_RADIUS + [0, y, 0] for y in (_BASE_TOP, _BASE_BOTTOM)])
    turns = 6 * repeat
    v = turns * height / (2 * np.pi * _BASE_RADIUS)
    side_uv = np.stack([np.stack([turns * angle / (2 * np.pi), 0 * angle + y], -1) for y in (0, v)])
    grid = _grid(1, around)
    drum = with_tangents("side", side.reshape(-1, 3), np.concatenate([ring, ring]), side_uv.reshape(-1, 2), grid)
    inner = np.sqrt(1 - _BASE_TOP**2) * 0.98
    top = np.stack([ring * r + [0, _BASE_TOP, 0] for r in (inner, _BASE_RADIUS)]).reshape(-1, 3)
    top_uv = top[:, [0, 2]] * turns / (2 * np.pi * _BASE_RADIUS)
    return [drum, with_tangents("top", top, np.tile([0.0, 1.0, 0.0], (len(top), 1)), top_uv, grid)]


def _grid(rows: int, columns: int) -> NDArray[np.int32]:
    """(2 rows columns, 3): triangles of a grid of vertices, seen counter-clockwise with rows running down."""
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = i * (columns + 1) + j
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    return np.stack([np.stack([a, c, d], -1), np.stack([a, d, b], -1)], -2).reshape(-1, 3).astype(np.int32)
