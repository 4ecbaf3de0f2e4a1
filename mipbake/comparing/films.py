"""The films that methods are compared in: a floor seen from above, a low floor, a wall at about one texel a pixel, a
turning sphere, or a mesh of the user's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from mipbake.base.errors import UsageError
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera, Vector
from mipbake.comparing.meshes.film import Film
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_render import Shot
from mipbake.comparing.scenes import exposed, mesh_views, sphere_shot
from mipbake.quality.environment import Lighting

RESOLUTION = (160, 240)
"""(height, width) of films in pixels. A guess: about 4 and 6.5 degrees of sight at 37 pixels per degree."""

FRAMES = 12
"""Frames of a film. A guess: 0.4 seconds, at FRAMES_PER_SECOND."""

FRAMES_PER_SECOND = 30.0
"""A guess: what games run at on slower machines."""

Motion = Literal["camera", "light"]
"""What moves: the camera, or the lights, which turn round the vertical."""

MOTIONS: tuple[Motion, ...] = get_args(Motion)

_TURN = 0.25  # degrees from frame to frame, of spheres, of meshes and of lights
_SPHERE_LOD = 1.0  # median level of detail of the sphere
_HORIZON = 1000  # times the height of the eye, where the ground ends: a quarter of a pixel below the horizon


@dataclass(frozen=True)
class _Ground:
    """A film of the ground, which a camera goes over.

    All of these are guesses at what people look at. Lengths are in the world.

    Args:
        name, title: of the film.
        eye: height of the camera. down: degrees by which it looks below the horizon.
        field: horizontal field of view, degrees.
        texels: to the unit, in a film as high as RESOLUTION; as many fewer in a lower one, whose pixels are larger.
        step: of the camera from frame to frame, to the right and ahead.
    """

    name: str
    title: str
    eye: float
    down: float
    field: float
    texels: float
    step: tuple[float, float]


_GROUNDS = (
    _Ground("floor", "Floor, 11 to 45 degrees below the horizon", 1.0, 28, 50, 700, (0.0009, 0.0019)),
    _Ground("low-floor", "Low floor, up to 31 degrees below the horizon", 0.5, 14, 50, 700, (0.0006, 0.0021)),
    # The pixel in the middle is 1.15 texels wide. Lights fall on this wall as they do on floors.
    _Ground("wall", "Wall, about one texel a pixel", 1.0, 78, 40, 371, (0.0017, 0.0006)),
)


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
        name: key, also of files: `floor`, `low-floor`, `wall`, `sphere` or `mesh`. title: what a reader is shown.
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
    """Floors, wall and sphere for a texture of `size` (height, width), whose texels stay square on them.

    The ground repeats the texture, so that texels are as large for any size. What is above the horizon is black.
    """
    grounds = tuple(_ground_film(each, size, lighting, motion, frames, resolution) for each in _GROUNDS)
    sphere = sphere_shot(size, lighting, min(_SPHERE_LOD, float(last_level)), resolution)
    return (*grounds, FilmScene("sphere", "Turning sphere", _turning(sphere, motion, frames)))


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


def _ground_film(
    ground: _Ground,
    size: tuple[int, int],
    lighting: Lighting,
    motion: Motion,
    frames: int,
    resolution: tuple[int, int],
) -> FilmScene:
    """The film, with the middle of the texture in the middle of the picture: sets that do not repeat fill it."""
    eye, down = ground.eye, math.radians(ground.down)
    camera = Camera(
        (0.0, eye, 0.0),
        (0.0, eye - math.sin(down), -math.cos(down)),
        field_of_view=2
        * math.degrees(math.atan(math.tan(math.radians(ground.field) / 2) * resolution[0] / resolution[1])),
        near=0.01 * eye,
        far=2 * _HORIZON * eye,
    )
    flat = shapes.plane(2 * _HORIZON * eye, 2 * _HORIZON * eye)
    middle = flat.positions + np.array(
        [0.0, 0.0, eye / math.tan(down)]
    )  # from where the picture's middle meets the ground
    texels = ground.texels * resolution[0] / RESOLUTION[0]
    uv = 0.5 + middle[:, [0, 2]] * texels / np.array([size[1], size[0]], np.float64)
    mesh = Mesh(ground.name, flat.positions, flat.normals, uv, flat.tangents, flat.triangles)
    right, ahead = ground.step
    shot = Shot(mesh, camera, _from_ahead(lighting), resolution)
    return FilmScene(ground.name, ground.title, _moving(shot, (right, 0.0, -ahead), motion, frames))


def _from_ahead(lighting: Lighting) -> Lighting:
    """The lights turned about the vertical, so that their mean comes from where the camera looks, -z.

    There grounds mirror them: the sun behind the camera is no test of a floor.
    """
    x, _, z = lighting.radiance.sum(-1) @ lighting.direction
    away = math.degrees(math.atan2(x, -z))
    return replace(lighting, direction=lighting.direction @ _about_y(away).T)


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
