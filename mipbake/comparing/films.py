"""The films that methods are compared in: a floor seen from above, a low floor, a wall at about one texel a pixel, a
turning sphere, or a mesh of the user's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from mipbake.base.names import known_name
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera, Vector
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.visible import Shot
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

FILM = "film-"
"""What the names of films begin with."""

_TURN = 0.25  # degrees from frame to frame, of spheres, of meshes and of lights
_SPHERE_LOD = 1.0  # median level of detail of the sphere
_HORIZON = 1000  # times the height of the eye, where the ground ends: a quarter of a pixel below the horizon


class _Ground(NamedTuple):
    """A film of the ground, which a camera goes over: guesses at what people look at. Lengths are in the world."""

    name: str
    title: str
    eye: float  # height of the camera
    down: float  # degrees by which it looks below the horizon
    field: float  # horizontal field of view, degrees
    texels: float  # to the unit, in a film as high as RESOLUTION; as many fewer in a lower one, whose pixels are larger
    step: tuple[float, float]  # of the camera from frame to frame, to the right and ahead


_GROUNDS = (
    _Ground("floor", "Floor, 11 to 45 degrees below the horizon", 1.0, 28, 50, 700, (0.0009, 0.0019)),
    _Ground("low-floor", "Low floor, up to 31 degrees below the horizon", 0.5, 14, 50, 700, (0.0006, 0.0021)),
    # The pixel in the middle is 1.15 texels wide. Lights fall on this wall as they do on floors.
    _Ground("wall", "Wall, about one texel a pixel", 1.0, 78, 40, 371, (0.0017, 0.0006)),
)


def motion_named(name: str) -> Motion:
    """The motion of that name; UsageError, with the list of names, where there is none."""
    return next(motion for motion in MOTIONS if motion == known_name("motion", name, MOTIONS))


@dataclass(frozen=True, eq=False)
class Film:
    """What is filmed.

    Args:
        name: key, also of files, and the view of its figures: `film-floor`, `film-low-floor`, `film-wall`,
            `film-sphere` or `film-mesh`.
        title: what a reader is shown.
        motion: what moves. The mesh stays where it is: what turns is seen by a camera that goes round it.
        shots: the frames.
    """

    name: str
    title: str
    motion: Motion
    shots: tuple[Shot, ...]


def films_of(
    size: tuple[int, int],
    lighting: Lighting,
    last_level: int,
    mesh: Mesh | None = None,
    motion: Motion = "camera",
    height: int = RESOLUTION[0],
    frames: int = FRAMES,
) -> tuple[Film, ...]:
    """The films of a texture of `size` (height, width), `height` pixels high: of the mesh, if there is one, turning
    from where it fills the picture.

    Texels stay square. The ground repeats the texture, so that texels are as large for any size. What is above the
    horizon is black.

    Raises:
        InputError: a mesh that cannot be seen.
    """
    resolution = height, height * RESOLUTION[1] // RESOLUTION[0]
    if mesh:
        shot = mesh_views(mesh, size, lighting, resolution)[0]
        return (Film(f"{FILM}mesh", f"{mesh.name}, turning", motion, _turning(shot, motion, frames)),)
    grounds = tuple(_ground_film(each, size, lighting, motion, frames, resolution) for each in _GROUNDS)
    sphere = sphere_shot(size, exposed(lighting), min(_SPHERE_LOD, float(last_level)), resolution)
    return (*grounds, Film(f"{FILM}sphere", "Turning sphere", motion, _turning(sphere, motion, frames)))


def _ground_film(
    ground: _Ground,
    size: tuple[int, int],
    lighting: Lighting,
    motion: Motion,
    frames: int,
    resolution: tuple[int, int],
) -> Film:
    """The film, with the middle of the texture in the middle of the picture: sets that do not repeat fill it."""
    eye, down = ground.eye, math.radians(ground.down)
    field = 2 * math.atan(math.tan(math.radians(ground.field) / 2) * resolution[0] / resolution[1])
    camera = Camera(
        (0.0, eye, 0.0),
        (0.0, eye - math.sin(down), -math.cos(down)),
        field_of_view=math.degrees(field),
        near=0.01 * eye,
        far=2 * _HORIZON * eye,
    )
    flat = shapes.plane(2 * _HORIZON * eye, 2 * _HORIZON * eye)
    middle = flat.positions + np.array([0.0, 0.0, eye / math.tan(down)])  # from where the view meets the ground
    texels = ground.texels * resolution[0] / RESOLUTION[0]
    uv = 0.5 + middle[:, [0, 2]] * texels / np.array([size[1], size[0]], np.float64)
    mesh = replace(flat, name=ground.name, uv=uv)
    right, ahead = ground.step
    still = Shot(mesh, camera, exposed(_from_ahead(lighting)), resolution)
    shots = _lit_in_turn(still, frames) if motion == "light" else _moving(still, np.array([right, 0.0, -ahead]), frames)
    return Film(f"{FILM}{ground.name}", ground.title, motion, shots)


def _from_ahead(lighting: Lighting) -> Lighting:
    """The lights turned about the vertical, so that their mean comes from where the camera looks, -z.

    There grounds mirror them: the sun behind the camera is no test of a floor.
    """
    x, _, z = lighting.radiance.sum(-1) @ lighting.direction
    return _turned(lighting, _about_y(math.degrees(math.atan2(x, -z))))


def _moving(shot: Shot, step: NDArray[np.float64], frames: int) -> tuple[Shot, ...]:
    """A camera that goes on by a step in the world each frame."""
    c = shot.camera
    return tuple(
        replace(
            shot,
            camera=replace(c, position=_vector(c.position + index * step), looks_at=_vector(c.looks_at + index * step)),
        )
        for index in range(frames)
    )


def _turning(shot: Shot, motion: Motion, frames: int) -> tuple[Shot, ...]:
    """A camera that goes round its target about the vertical, and takes the lights along: what turns is the mesh."""
    if motion == "light":
        return _lit_in_turn(shot, frames)
    c, shots = shot.camera, []
    for index in range(frames):
        turn = _about_y(_TURN * index)
        position = np.add(c.looks_at, turn @ np.subtract(c.position, c.looks_at))
        camera = replace(c, position=_vector(position), up=_vector(turn @ np.asarray(c.up)))
        shots.append(replace(shot, camera=camera, lighting=_turned(shot.lighting, turn)))
    return tuple(shots)


def _lit_in_turn(shot: Shot, frames: int) -> tuple[Shot, ...]:
    """A camera that stays where it is, under lights that turn about the vertical."""
    turns = (_about_y(_TURN * index) for index in range(frames))
    return tuple(replace(shot, lighting=_turned(shot.lighting, turn)) for turn in turns)


def _turned(lighting: Lighting, turn: NDArray[np.float64]) -> Lighting:
    return replace(lighting, direction=lighting.direction @ turn.T)


def _about_y(degrees: float) -> NDArray[np.float64]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
