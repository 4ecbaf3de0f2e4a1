"""The views that engines render: a receding plane, a wall seen straight on and a sphere, each at four scales."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera, orbit
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.scenes import median_lod
from mipbake.quality.figures import SCALES

_SPHERE_ANGLE = 25.0  # vertical field of view, degrees
_SPHERE_ROWS = 32  # rows of quads from pole to pole
_FILLED = 0.94  # share of the picture's half height that the sphere fills
_PLANE_DOWN, _PLANE_ANGLE = 35.0, 28.0  # the middle of the view below the horizon, its height, degrees
_WALL_TURN, _WALL_ANGLE = 20.0, 20.0  # of the picture about its middle, its height, degrees


@dataclass(frozen=True, eq=False)
class EngineView:
    """What is rendered.

    Args:
        name: `plane-near`, `sphere-1:1`, ...
        shape, scale: `plane`, `wall` or `sphere`; a name in mipbake.quality.figures.SCALES.
        lod: median level of detail of the pixels.
        mesh, camera: the scene.
        side: pixels a side of the picture.
    """

    name: str
    shape: str
    scale: str
    lod: float
    mesh: Mesh
    camera: Camera
    side: int

    def described(self) -> dict[str, Any]:
        """What the page takes."""
        return described(self.mesh, self.camera, (self.side, self.side))


def described(mesh: Mesh, camera: Camera, resolution: tuple[int, int]) -> dict[str, Any]:
    """A convex mesh as a page takes it, with the triangles that face the camera alone; resolution: (height, width)."""
    corners = mesh.positions[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = ((np.array(camera.position) - corners[:, 0]) * normals).sum(-1) > 0
    arrays = {
        "positions": mesh.positions,
        "normals": mesh.normals,
        "uv": mesh.uv,
        "tangents": mesh.tangents,
        "triangles": mesh.triangles[facing],
    }
    return {
        **{name: np.asarray(values).reshape(-1).tolist() for name, values in arrays.items()},
        **{"position": camera.position, "target": camera.looks_at, "up": camera.up},
        **{"fieldOfView": camera.field_of_view, "near": camera.near, "far": camera.far},
        **{"width": resolution[1], "height": resolution[0]},
    }


def engine_views(size: tuple[int, int], last_level: int, side: int) -> Iterator[EngineView]:
    """Planes, walls, then spheres, at every scale, for a texture of `size` (height, width).

    The camera stays; the texture repeats so often that the median level of detail of the pixels that show the surface
    is the middle of the scale, or `last_level` where that is less.
    """
    for shape, (mesh, camera) in {"plane": _plane(size), "wall": _wall(size), "sphere": _sphere(size)}.items():
        once = median_lod(mesh, camera, (side, side), size)
        for scale, lods in SCALES.items():
            lod = min(sum(lods) / 2, float(last_level))
            uv = mesh.uv * 2 ** (lod - once)
            seen = Mesh(shape, mesh.positions, mesh.normals, uv, mesh.tangents, mesh.triangles)
            yield EngineView(f"{shape}-{scale}", shape, scale, lod, seen, camera, side)


def _plane(size: tuple[int, int]) -> tuple[Mesh, Camera]:
    """The ground seen from height 1, which fills the picture."""
    down = math.radians(_PLANE_DOWN)
    camera = Camera(
        (0.0, 1.0, 0.0), (0.0, 1.0 - math.sin(down), -math.cos(down)), field_of_view=_PLANE_ANGLE, near=0.1, far=40.0
    )
    reach = 2 / math.tan(down - math.radians(_PLANE_ANGLE) / 2)
    ground = shapes.plane(2 * reach, reach)
    positions = ground.positions - np.array([0, 0, reach / 2])
    uv = positions[:, [0, 2]] * [size[0] / size[1], 1.0]
    return Mesh("plane", positions, ground.normals, uv, ground.tangents, ground.triangles), camera


def _wall(size: tuple[int, int]) -> tuple[Mesh, Camera]:
    """A square seen straight on, which fills the picture, where footprints are as wide as long; turned, so that pixels
    fall anywhere between texels.
    """
    turn = math.radians(_WALL_TURN)
    camera = Camera((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), up=(math.sin(turn), 0.0, -math.cos(turn)),
                    field_of_view=_WALL_ANGLE, near=0.1, far=40.0)  # fmt: skip
    wall = shapes.plane(1.0, 1.0)
    uv = wall.positions[:, [0, 2]] * [size[0] / size[1], 1.0]
    return Mesh("wall", wall.positions, wall.normals, uv, wall.tangents, wall.triangles), camera


def _sphere(size: tuple[int, int]) -> tuple[Mesh, Camera]:
    """A sphere that fills the picture; its texture goes twice as often around as from pole to pole."""
    angle = math.atan(_FILLED * math.tan(math.radians(_SPHERE_ANGLE) / 2))
    camera = orbit(1 / math.sin(angle), 0.0, 12.0, field_of_view=_SPHERE_ANGLE)
    return shapes.sphere(_SPHERE_ROWS, repeat=(2 * size[0] / size[1], 1.0)), camera
