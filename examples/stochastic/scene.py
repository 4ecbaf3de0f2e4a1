"""A ball of quadrilaterals with texture coordinates, a bumpy one that pictures are made of, lights and cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shared import textures

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]

DISTANCE, SLOPE = 5.0, 0.29
"""Of cameras from the middle of the ball, and half a picture's width at distance 1."""
WIDTH = 2 * SLOPE * DISTANCE
"""Of pictures, at the ball."""

LIGHTS = np.array(
    [[1, 0.3, 0.4], [-0.6, 0.7, 0.5], [-0.3, -0.9, 0.3], [0.2, 0.1, -1], [0.1, 1, -0.2], [-1, -0.2, -0.4]]
)
LIGHTS /= np.linalg.norm(LIGHTS, axis=-1, keepdims=True)
RADIANCE = 2.5 * np.array(
    [[2, 1.5, 1.1], [0.9, 1.4, 1.9], [1.2, 0.8, 1.3], [1.3, 1.7, 1], [1, 1, 1.4], [1.5, 1.2, 0.9]]
)
"""Directions to lights, and what they shed."""

HELD_OUT = 4
"""Cameras that nothing is learned from."""

CHARTS = (3, 2)
"""Columns and rows of the atlas: a chart for each side of a cube."""


@dataclass(frozen=True)
class Ball:
    """The unit ball as a cube whose sides are grids, blown up.

    Args:
        points: (V, 3), unit vectors.
        quads: (F, 4), counter-clockwise seen from outside.
        uv: (F, 4, 2): where the corners are in the atlas. Sides share no texel, not even under bilinear filtering.
    """

    points: Floats
    quads: Ints
    uv: Floats

    @property
    def triangles(self) -> Ints:
        return self.quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def ball(steps: int, texture_size: int) -> Ball:
    """With sides of `steps` times `steps` quads, for maps of so many texels in each direction."""
    line = np.arange(steps + 1)
    across, up = np.meshgrid(line, line)
    index = np.arange((steps + 1) ** 2).reshape(steps + 1, steps + 1)
    grid = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1).reshape(-1, 4)
    columns, rows = CHARTS
    margin = 1 / texture_size
    points, quads, uv = [], [], []
    for side in range(6):
        axis, positive = side % 3, side < 3
        face = np.empty(((steps + 1) ** 2, 3), np.int64)
        face[:, axis] = steps * positive
        face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = across.ravel(), up.ravel()
        own = grid if positive else grid[:, ::-1]
        corner, room = np.array([side % columns / columns, side // columns / rows]), 1 / np.array(CHARTS) - 2 * margin
        uv.append((corner + margin + room * np.stack([across, up], -1).reshape(-1, 2) / steps)[own])
        quads.append(own + len(face) * side)
        points.append(face)
    vertices, same = np.unique(np.concatenate(points), axis=0, return_inverse=True)
    # Equal angles between grid lines, so that quads are of about one size.
    direction = np.tan((vertices / steps - 0.5) * (np.pi / 2))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    corners = same.reshape(-1)[np.concatenate(quads)]
    return Ball(direction.astype(np.float32), corners.astype(np.int32), np.concatenate(uv).astype(np.float32))


def radius(direction: Floats) -> Floats:
    """(...,) of the bumpy ball towards unit vectors (..., 3): lobes, and ripples on them."""
    x, y, z = np.moveaxis(direction, -1, 0)
    lobes = 0.22 * np.sin(2.4 * x + 1) * np.cos(2.9 * y) + 0.16 * np.cos(3.1 * z + 2 * x - y)
    ripples = textures.fractal_noise(direction, 2.5, 12, 0.55, seed=3)
    return (0.95 + lobes + 0.05 * ripples).astype(np.float32)


def distance(points: Floats) -> float:
    """Mean distance of points (V, 3) from the bumpy ball, by radii."""
    away = np.linalg.norm(points, axis=-1)
    return float(np.abs(away - radius(points / away[:, None])).mean())


def normals(points: Floats, triangles: Ints) -> Floats:
    """(V, 3) unit normals: the mean over the triangles at a vertex, weighed by area."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    area = np.cross(b - a, c - a).repeat(3, 0)
    at = triangles.reshape(-1)
    total = np.stack([np.bincount(at, area[:, axis], len(points)) for axis in range(3)], -1)
    return (total / np.linalg.norm(total, axis=-1, keepdims=True)).astype(np.float32)


def painted(direction: Floats) -> Floats:
    """(V, 5) base colour, metallic and roughness: enamel that is worn down to metal on the ridges."""
    noise = textures.fractal_noise(direction, 2, 16, 0.6, seed=11)
    worn = np.clip(4 * noise - 0.4, 0, 1)[:, None]
    stripes = (np.mod(5 * direction[:, 1] + 0.3 * noise, 1) < 0.5)[:, None]
    enamel = np.where(stripes, [0.75, 0.2, 0.1, 0, 0.35], [0.1, 0.3, 0.55, 0, 0.5])
    return (enamel + worn * ([0.9, 0.75, 0.45, 1, 0.3] - enamel)).astype(np.float32)


def bumpy_ball(steps: int) -> tuple[Floats, Floats, Floats, Ints]:
    """What pictures are of, in small triangles: points (V, 3), normals (V, 3), paint (V, 5) and triangles (T, 3)."""
    fine = ball(steps, 8)
    points = fine.points * radius(fine.points)[:, None]
    return points, normals(points, fine.triangles), painted(fine.points), fine.triangles


@dataclass(frozen=True, eq=False)
class Camera:
    eye: Floats
    """(3,)"""
    to_clip: Floats
    """(4, 4), for columns"""


def cameras(count: int) -> tuple[list[Camera], list[Camera]]:
    """HELD_OUT cameras, and `count` others to learn from, all of them evenly around the origin."""
    count += HELD_OUT
    found = []
    for number in range(count):
        height, turn = 1 - (2 * number + 1) / count, number * np.pi * (3 - np.sqrt(5))
        back = np.array([*(np.sqrt(1 - height**2) * np.array([np.cos(turn), np.sin(turn)])), height])
        right = np.cross([0.1, 0.9, 0.2], back)
        right /= np.linalg.norm(right)
        view = np.eye(4)
        view[:3, :3] = right, np.cross(back, right), back
        view[2, 3] = -DISTANCE
        near, far = DISTANCE - 2, DISTANCE + 2
        lens = np.diag([1 / SLOPE, 1 / SLOPE, -(far + near) / (far - near), 0])
        lens[2, 3], lens[3, 2] = -2 * far * near / (far - near), -1
        found.append(Camera((back * DISTANCE).astype(np.float32), (lens @ view).astype(np.float32)))
    held_out = found[2 :: count // HELD_OUT][:HELD_OUT]
    return held_out, [camera for camera in found if camera not in held_out]
