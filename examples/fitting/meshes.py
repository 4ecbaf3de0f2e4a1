"""Closed triangle meshes, made in code. Vertices that coincide are one vertex: silhouettes are found by index."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Mesh:
    positions: Tensor
    """(V, 3) float32"""
    triangles: Tensor
    """(T, 3) int32, counter-clockwise seen from outside"""

    def to(self, device: str) -> Mesh:
        return Mesh(self.positions.to(device), self.triangles.to(device))


_CORNERS = (
    (slice(None, -1), slice(None, -1)),
    (slice(None, -1), slice(1, None)),
    (slice(1, None), slice(1, None)),
    (slice(1, None), slice(None, -1)),
)
"""Corners of every square of a grid, counter-clockwise: rows and columns."""


def _face_grids(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The six faces of [0, steps]^3 as grids of unit squares: integer points (6 (steps + 1)^2, 3) and triangles."""
    across, up = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="xy")
    index = np.arange((steps + 1) ** 2).reshape(steps + 1, steps + 1)
    a, b, c, d = (index[rows, columns].ravel() for rows, columns in _CORNERS)
    grid = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    points, triangles = [], []
    for axis in range(3):
        for side in (0, steps):
            face = np.empty(((steps + 1) ** 2, 3), np.int64)
            face[:, axis] = side
            face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = across.ravel(), up.ravel()
            triangles.append((grid if side else grid[:, ::-1]) + len(points) * len(face))
            points.append(face)
    return np.concatenate(points), np.concatenate(triangles)


def cube() -> tuple[Mesh, Tensor]:
    """The unit cube around the origin, 8 vertices, and its triangles (12, 3) over 24 corners, four a face.

    The corners are for attributes that jump at the edges; corner c belongs to face c // 4.
    """
    points, corners = _face_grids(1)
    vertices, shared = np.unique(points, axis=0, return_inverse=True)
    triangles = shared.reshape(-1)[corners]
    mesh = Mesh(torch.tensor(vertices - 0.5, dtype=torch.float32), torch.tensor(triangles, dtype=torch.int32))
    return mesh, torch.tensor(corners.copy(), dtype=torch.int32)


def cube_symmetries() -> Tensor:
    """(24, 4): the rotations, as quaternions, that map the cube to itself."""
    r = 0.5**0.5
    first = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    edges = [[0, r, r, 0], [0, r, -r, 0], [0, r, 0, r], [0, r, 0, -r], [0, 0, r, r], [0, 0, r, -r]]
    quarters = [[r, *(s * r * (axis == k) for k in range(3))] for axis in range(3) for s in (1, -1)]
    diagonals = [[0.5, 0.5 * x, 0.5 * y, 0.5 * z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]
    return torch.tensor(first + edges + quarters + diagonals)


def sphere(steps: int) -> Mesh:
    """The unit sphere: a cube whose faces are grids of `steps` squares a side, blown up. Positions are directions."""
    points, triangles = _face_grids(steps)
    vertices, shared = np.unique(points, axis=0, return_inverse=True)
    # Equal angles between grid lines, so that triangles are of about one size.
    direction = np.tan((vertices / steps - 0.5) * (np.pi / 2))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return Mesh(
        torch.tensor(direction, dtype=torch.float32), torch.tensor(shared.reshape(-1)[triangles], dtype=torch.int32)
    )


def bumpy_knot(along: int = 240, around: int = 24) -> tuple[Mesh, Tensor]:
    """A trefoil's tube with bumps, within the unit sphere, and its vertex normals (V, 3)."""
    s, t = np.meshgrid(np.arange(along) / along, np.arange(around) / around, indexing="ij")
    s, t = 2 * np.pi * s, 2 * np.pi * t

    def curve(s: np.ndarray) -> np.ndarray:
        return np.stack(
            [(2 + np.cos(3 * s)) * np.cos(2 * s), (2 + np.cos(3 * s)) * np.sin(2 * s), 1.2 * np.sin(3 * s)], -1
        )

    step = 1e-4
    tangent = curve(s + step) - curve(s - step)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    outward = curve(s) * [1, 1, 0]
    outward -= (outward * tangent).sum(-1, keepdims=True) * tangent
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    radius = 0.62 + 0.06 * np.cos(3 * t + 7 * s) + 0.05 * np.sin(2 * t - 11 * s)
    ring = np.cos(t)[..., None] * outward + np.sin(t)[..., None] * np.cross(tangent, outward)
    points = (curve(s) + radius[..., None] * ring).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=-1).max()
    index = np.arange(along * around).reshape(along, around)
    a, b = index, np.roll(index, -1, 0)
    c, d = np.roll(b, -1, 1), np.roll(a, -1, 1)
    triangles = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    return Mesh(torch.tensor(points, dtype=torch.float32), torch.tensor(triangles, dtype=torch.int32)), torch.tensor(
        vertex_normals(points, triangles), dtype=torch.float32
    )


def vertex_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals: the mean over the triangles around a vertex, weighed by area."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    area = np.cross(b - a, c - a)
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], area)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)
