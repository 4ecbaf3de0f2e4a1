"""The films that methods are compared in: a receding floor, a wall at about one texel a pixel, a turning sphere, or a
mesh of the user's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from mipbake.compare.scenes import exposed, mesh_views, plane_shot, sphere_shot
from mipbake.errors import UsageError
from mipbake.render import shapes
from mipbake.render.camera import Camera, Vector
from mipbake.render.environment import Lighting
from mipbake.render.film import Film
from mipbake.render.mesh import Mesh
from mipbake.render.mesh_render import Shot

RESOLUTION = (160, 240)
"""(height, width) of films in pixels. A guess: about 4 and 6.5 degrees of sight at 37 pixels per degree."""

FRAMES = 16
"""Frames of a film. A guess: half a second, at FRAMES_PER_SECOND."""

FRAMES_PER_SECOND = 30.0
"""A guess: what games run at on slower machines."""

Motion = Literal["camera", "light"]
"""What moves: the camera, or the lights, which turn round the vertical."""

MOTIONS: tuple[Motion, ...] = get_args(Motion)

FLOOR_LAST = 4
"""Level of detail at the top of the floor, where the stack has so many levels; it is 0 at the bottom."""

_STEP = (0.61, 0.37)  # texels of level 0 to the right and ahead, from frame to frame, on floor and wall
_TURN = 0.25  # degrees from frame to frame, of spheres, of meshes and of lights
_WALL_LOD = 0.25  # level of detail in the middle of the wall; a guess: from 0 to 0.5 over the picture
_WALL_ANGLE = 12.0  # degrees that the wall is turned by, which spreads its levels of detail
_WALL_FIELD = 30.0  # vertical field of view, degrees
_SPHERE_LOD = 1.0  # median level of detail of the sphere


def motion_named(name: str) -> Motion:
    """The motion of that name; UsageError, with the list of names, where there is none."""
    for motion in MOTIONS:
        if motion == name:
            return motion
    raise UsageError(f"no motion is called {name!r}: expected {' or '.join(MOTIONS)}")


@dataclass(frozen=True, eq=False)
class FilmScene:
    """A film with its names.

    Args:
        name: key, also of files: `floor`, `wall`, `sphere` or `mesh`. title: what a reader is shown.
    """

    name: str
    title: str
    film: Film


def standard_films(
    size: tuple[int, int],
    lighting: Lighting,
    last_level: int,
    motion: Motion = "camera",
    frames: int = FRAMES,
    resolution: tuple[int, int] = RESOLUTION,
) -> tuple[FilmScene, ...]:
    """Floor, wall and sphere for a texture of `size` (height, width), whose texels stay square on them."""
    floor_last = min(FLOOR_LAST, last_level)
    floor = plane_shot(size, lighting, floor_last, resolution)
    wall = _wall_shot(size, lighting, resolution)
    sphere = sphere_shot(size, lighting, min(_SPHERE_LOD, float(last_level)), resolution)
    texel = 1 / (np.ptp(floor.mesh.uv[:, 0]) / np.ptp(floor.mesh.positions[:, 0]) * size[1])
    ahead = (_STEP[0] * texel, 0.0, -_STEP[1] * texel)
    across = (_STEP[0] * _WALL_TEXEL, _STEP[1] * _WALL_TEXEL, 0.0)
    return (
        FilmScene("floor", f"Floor, lod 0 to {floor_last}", _moving(floor, ahead, motion, frames)),
        FilmScene("wall", "Wall, about one texel a pixel", _moving(wall, across, motion, frames)),
        FilmScene("sphere", "Turning sphere", _turning(sphere, motion, frames)),
    )


def mesh_films(
    mesh: Mesh,
    size: tuple[int, int],
    lighting: Lighting,
    motion: Motion = "camera",
    frames: int = FRAMES,
    resolution: tuple[int, int] = RESOLUTION,
) -> tuple[FilmScene, ...]:
    """A turning mesh of the user's, from where it fills the picture; errors as `scenes.mesh_views`."""
    shot = mesh_views(mesh, size, lighting, resolution)[0].shot
    still = Shot(shot.mesh, shot.camera, lighting, resolution)
    return (FilmScene("mesh", f"{mesh.name}, turning", _turning(still, motion, frames)),)


_WALL_TEXEL = 1 / 256  # in the world; not tuned: only its ratio to the distance is seen


def _wall_shot(size: tuple[int, int], lighting: Lighting, resolution: tuple[int, int]) -> Shot:
    """A wall through the origin, upright, turned a little about the vertical."""
    height, width = resolution
    pixel = _WALL_TEXEL * 2**_WALL_LOD  # on the middle of the wall
    distance = pixel * height / 2 / math.tan(math.radians(_WALL_FIELD) / 2)
    side = 4 * pixel * (height + width)
    ground = shapes.plane(side, side)
    # The plane lies on the ground with v along +z: it is raised, so that v runs downwards.
    raised = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    turned = _about_y(_WALL_ANGLE) @ raised
    tangents = np.concatenate([ground.tangents[:, :3] @ turned.T, ground.tangents[:, 3:]], 1)
    # The middle of the texture in the middle of the picture: sets that do not repeat fill it.
    uv = 0.5 + (ground.uv - 0.5) * side / _WALL_TEXEL / np.array([size[1], size[0]], np.float64)
    mesh = Mesh("wall", ground.positions @ turned.T, ground.normals @ turned.T, uv, tangents, ground.triangles)
    camera = Camera((0.0, 0.0, distance), field_of_view=_WALL_FIELD, near=0.1 * distance, far=10 * distance)
    return Shot(mesh, camera, lighting, resolution)


def _moving(shot: Shot, step: Vector, motion: Motion, frames: int) -> Film:
    """A camera that goes on by a step in the world each frame, or one that stays while the lights turn."""
    if motion == "light":
        return _lit_in_turn(shot, frames)
    c = shot.camera
    cameras = tuple(
        replace(c, position=_plus(c.position, step, index), looks_at=_plus(c.looks_at, step, index))
        for index in range(frames)
    )
    return Film(shot.mesh, cameras, (exposed(shot.lighting),) * frames, shot.resolution)


def _turning(shot: Shot, motion: Motion, frames: int) -> Film:
    """A camera that goes round its target about the vertical, and takes the lights along: what turns is the mesh."""
    if motion == "light":
        return _lit_in_turn(shot, frames)
    c, lights = shot.camera, exposed(shot.lighting)
    cameras, lightings = [], []
    for index in range(frames):
        turn = _about_y(_TURN * index)
        offset = turn @ np.subtract(c.position, c.looks_at)
        cameras.append(replace(c, position=_plus(c.looks_at, _vector(offset), 1), up=_vector(turn @ np.asarray(c.up))))
        lightings.append(replace(lights, direction=lights.direction @ turn.T))
    return Film(shot.mesh, tuple(cameras), tuple(lightings), shot.resolution)


def _lit_in_turn(shot: Shot, frames: int) -> Film:
    """A camera that stays where it is, under lights that turn about the vertical."""
    lights = exposed(shot.lighting)
    lightings = tuple(
        replace(lights, direction=lights.direction @ _about_y(_TURN * index).T) for index in range(frames)
    )
    return Film(shot.mesh, (shot.camera,) * frames, lightings, shot.resolution)


def _about_y(degrees: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _vector(values: ArrayLike) -> Vector:
    x, y, z = (float(value) for value in np.asarray(values))
    return x, y, z


def _plus(point: Vector, step: Vector, times: float) -> Vector:
    return _vector(np.add(point, np.multiply(step, times)))
