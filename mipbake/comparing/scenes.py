"""The views that methods are compared in: spheres at the four scales, a receding plane, or a mesh of the user's."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mipbake import raster
from mipbake.base.errors import InputError
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera, orbit
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.visible import Shot
from mipbake.quality.environment import Lighting
from mipbake.quality.figures import SCALES
from mipbake.quality.samplers import level_of_detail

SPHERE_RESOLUTION = (256, 256)  # pixels
PLANE_RESOLUTION = (256, 448)  # pixels

EXPOSURE = 1.5
"""Times the environments' own scale, under which a white matte sphere has radiance 1: pictures of common materials then
fill the range of a display. Measures of absolute luminance (delta E ITP, HDR-FLIP) see this exposure too."""

SMALLEST = 16
"""Least pixels along each side of a view; the window of SSIM takes 11. A guess above that."""

_SPHERE_ANGLE = 25.0  # vertical field of view, degrees
_FILLED = 0.94  # share of the picture's half height that the sphere's radius fills
_BOTTOM = 35.0  # degrees below the horizon of the lowest row of the plane
_MESH_ANGLE = 30.0  # vertical field of view, degrees
_MESH_FROM = (25.0, 15.0)  # azimuth and elevation, degrees
# Times the distance at which the mesh fills the picture.
_MESH_DISTANCES = {"near": 1.0, "middle": 3.0, "far": 8.0}


@dataclass(frozen=True, eq=False)
class View(Shot):
    """What is rendered, at least SMALLEST pixels high and wide.

    Args:
        name: key, also of files: `sphere-near`, `sphere-1-1`, ...
        title: what a reader is shown.
        view: kind of the view: `sphere`, `plane` or `mesh`.
        scale: a name in SCALES; empty for a view of all scales.
    """

    name: str
    title: str
    view: str
    scale: str


def exposed(lighting: Lighting) -> Lighting:
    """The lighting at EXPOSURE."""
    return replace(lighting, radiance=lighting.radiance * EXPOSURE)


def standard_views(
    size: tuple[int, int],
    lighting: Lighting,
    last_level: int,
    resolution: tuple[int, int] = SPHERE_RESOLUTION,
    plane_resolution: tuple[int, int] = PLANE_RESOLUTION,
) -> tuple[View, ...]:
    """Spheres at every scale, then a plane, for a texture of `size` (height, width), whose texels stay square on them.

    A sphere's texture repeats so often that the median level of detail of the covered pixels is the middle of its
    scale, or `last_level` where that is less. The plane recedes from one texel a pixel at the bottom to the last level
    at the top, short of the horizon. The lighting is that given at EXPOSURE.
    """
    lights, views = exposed(lighting), []
    for scale, lods in SCALES.items():
        lod = min(sum(lods) / 2, float(last_level))
        name, title = f"sphere-{scale.replace(':', '-')}", f"Sphere, {scale} (median lod {lod:g})"
        shot = sphere_shot(size, lights, lod, resolution)
        views.append(View(**vars(shot), name=name, title=title, view="sphere", scale=scale))
    plane, title = _plane_shot(size, lights, last_level, plane_resolution), f"Plane, lod 0 to {last_level}"
    return (*views, View(**vars(plane), name="plane", title=title, view="plane", scale=""))


def mesh_views(
    mesh: Mesh, size: tuple[int, int], lighting: Lighting, resolution: tuple[int, int] = SPHERE_RESOLUTION
) -> tuple[View, ...]:
    """A mesh as it is, from where it fills the picture, three times as far and eight times as far.

    Its texture coordinates are left alone, so the scales `near`, `middle` and `far` are the mesh's, and their median
    levels of detail for a texture of `size` (height, width) stand in the titles. The lighting is that given, at
    EXPOSURE.

    Raises:
        InputError: a mesh without extent, or a mesh that cannot be seen.
    """
    low, high = mesh.bounds()
    radius = float(np.linalg.norm(high - low)) / 2
    if radius == 0:
        raise InputError(f"mesh {mesh.name} has no extent: expected triangles with an area")
    x, y, z = (float(c) for c in (low + high) / 2)
    half = math.radians(_MESH_ANGLE) / 2
    narrow = math.atan(math.tan(half) * min(1.0, resolution[1] / resolution[0]))
    fitted = radius / math.sin(narrow)
    views = []
    for scale, times in _MESH_DISTANCES.items():
        distance = fitted * times
        near, far = max(distance - 1.1 * radius, 1e-3 * distance), distance + 1.1 * radius
        camera = replace(orbit(distance, *_MESH_FROM, (x, y, z), _MESH_ANGLE), near=near, far=far)
        lod = median_lod(mesh, camera, resolution, size)
        if math.isnan(lod):
            raise InputError(
                f"mesh {mesh.name} covers no pixel's centre from {times:g} times its size away: expected surfaces that "
                "can be seen at this resolution"
            )
        title = f"{mesh.name}, {scale}, median lod {lod:.1f}"
        views.append(View(mesh, camera, exposed(lighting), resolution, f"mesh-{scale}", title, "mesh", scale))
    return tuple(views)


def median_lod(mesh: Mesh, camera: Camera, resolution: tuple[int, int], size: tuple[int, int]) -> float:
    """Median of the unclamped level of detail of all covered pixels, for a texture of `size`; nan where none is."""
    clip: Any = camera.to_clip(mesh.positions, resolution)[None]
    triangles: Any = mesh.triangles
    uv: Any = mesh.uv
    rast, rast_db = raster.rasterize(None, clip, triangles, resolution)
    uv_da = raster.interpolate(uv, rast, triangles, rast_db, diff_attrs=[0, 1])[1]
    covered = uv_da[rast[..., 3] > 0]
    return float(np.median(level_of_detail(covered, size))) if len(covered) else math.nan


def sphere_shot(size: tuple[int, int], lighting: Lighting, lod: float, resolution: tuple[int, int]) -> Shot:
    """A sphere that fills the picture, whose texture repeats so often that the median level of detail is `lod`."""
    height, width = size
    # From outside, the outline of the sphere is seen at the angle of the tangent, not at the angle of its poles.
    angle = math.atan(_FILLED * math.tan(math.radians(_SPHERE_ANGLE) / 2) * min(1.0, resolution[1] / resolution[0]))
    camera = orbit(1 / math.sin(angle), 0.0, 12.0, field_of_view=_SPHERE_ANGLE)
    once = shapes.sphere(repeat=(2 * height / width, 1.0))  # twice as far around as from pole to pole
    times = 2 ** (lod - median_lod(once, camera, resolution, size))
    return Shot(replace(once, uv=once.uv * times), camera, lighting, resolution)


def _plane_shot(size: tuple[int, int], lighting: Lighting, last_level: int, resolution: tuple[int, int]) -> Shot:
    """A receding plane: one texel a pixel at the bottom of the picture, and the last level at its top."""
    # Seen from height 1, a ray at the angle a below the horizon meets the ground 1 / sin(a) away, and a pixel's
    # footprint is drawn out by another 1 / sin(a): the level of detail rises by 2 log2(sin(bottom) / sin(top)).
    bottom = math.radians(_BOTTOM)
    top = math.asin(math.sin(bottom) / 2 ** (max(last_level, 1) / 2))
    middle, angle = (bottom + top) / 2, bottom - top
    reach = 4 / math.tan(top)
    camera = Camera(
        (0.0, 1.0, 0.0),
        (0.0, 1.0 - math.sin(middle), -math.cos(middle)),
        field_of_view=math.degrees(angle),
        near=0.1,
        far=2 * reach,
    )
    aspect = resolution[1] / resolution[0]
    width, length = 2 * reach * math.tan(angle / 2) * aspect + 8, reach + 4
    ground = shapes.plane(width, length)
    # The ground starts behind the eye's foot and runs away from it.
    positions = ground.positions + np.array([0, 0, 2 - length / 2])
    # A pixel at the bottom is 2 tan(angle / 2) / height high at distance 1, and its footprint 1 / sin^2 longer.
    distance = 1 / math.sin(bottom) * math.cos(angle / 2)  # along the view, at which the lowest row lies
    texel = 2 * math.tan(angle / 2) / resolution[0] * distance / math.sin(bottom) / math.cos(angle / 2)
    uv = positions[:, [0, 2]] / texel / np.array([size[1], size[0]], np.float64)
    return Shot(replace(ground, positions=positions, uv=uv), camera, lighting, resolution)
