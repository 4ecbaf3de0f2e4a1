"""The views that shipped renderers know: a mesh under a few lights, as a camera sees it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.shapes import plane
from mipbake.material.pixel_filter import level_sizes
from mipbake.quality.environment import Lighting, directional

SCALES = ("near", "1:1", "middle", "far")
"""Scales of docs/validation.md, each with the views whose level of detail is nearest to it."""


@dataclass(frozen=True, eq=False)
class View:
    """A view of a textured mesh.

    Args:
        name: what messages call it.
        scale: which row of a table its errors count in: "near", "1:1", "middle" or "far".
        mesh, camera: in the world, right-handed with +y up.
        lighting: directional lights; directions point to the light.
        size: (height, width) in pixels.
        offset: how far the sampling points of all pixels are moved, (right, up) in pixels: the jitter of temporal
            anti-aliasing, by which references are supersampled.
    """

    name: str
    scale: str
    mesh: Mesh
    camera: Camera
    lighting: Lighting
    size: tuple[int, int]
    offset: tuple[float, float] = (0.0, 0.0)

    def moved(self, right: float, up: float) -> View:
        """The same view, with its sampling points moved by so many pixels."""
        return replace(self, offset=(self.offset[0] + right, self.offset[1] + up))

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) from the world to OpenGL's clip space, the offset included: clip = matrix @ (x, y, z, 1)."""
        height, width = self.size
        matrix = self.camera.projection_matrix(width / height) @ self.camera.view_matrix()
        matrix[:2] -= np.outer([2 * self.offset[0] / width, 2 * self.offset[1] / height], matrix[3])
        return np.asarray(matrix)


_DISTANCE, _FIELD_OF_VIEW = 4.0, 40.0  # of the camera
_SIDES = (48, 256)  # fewest and most pixels along a side of a view
_TILT = math.radians(60)  # most between a camera and the normal of the plane
_LIGHTS = 4  # of a view; one is near the mirror direction of the camera
_NEAR_MIRROR = 0.12  # radians, as in docs/conventions.md


def standard_views(
    size: tuple[int, int],
    wrap: tuple[str, str] = ("wrap", "wrap"),
    each: int = 16,
    seed: int = 0,
    lods: Sequence[float] | None = None,
) -> list[View]:
    """Views of a textured plane at levels of detail from 0 to the last one.

    Each has a camera of its own, up to 60 degrees from the normal, that looks at a place of its own on the plane, and
    four lights: one near the mirror direction of the camera, and three cosine-distributed over the hemisphere. A
    pixel's footprint at the middle of the picture has the level of detail on its longer side.

    Args:
        size: (height, width) of level 0 in texels.
        wrap: addressing. Where both axes wrap, the plane repeats the maps without end; else it shows them once.
        each: views at each level of detail.
        seed: of cameras and lights.
        lods: levels of detail; None: from 0 to the last level in steps of one half.

    Returns:
        The views of the first level of detail, then the views of the next one.
    """
    last = len(level_sizes(*size)) - 1
    found = [index / 2 for index in range(2 * last + 1)] if lods is None else list(lods)
    return [_view(size, wrap, lod, index, seed) for lod in found for index in range(each)]


def scale_of(lod: float) -> str:
    """The scale that a level of detail counts in."""
    bounds = (0.25, 1.25, 4.5)  # between the levels of detail of the scales: 0, 0 to 1, 3, and 7 or the last level
    return SCALES[sum(lod >= bound for bound in bounds)]


def _view(size: tuple[int, int], wrap: tuple[str, str], lod: float, index: int, seed: int) -> View:
    rng = np.random.default_rng([seed, round(1000 * lod), index])
    endless = wrap == ("wrap", "wrap")
    wanted = max(size) / 2**lod
    side = int(np.clip(round(wanted if endless else 1.5 * wanted), _SIDES[0] if endless else 4, _SIDES[1]))
    if not endless:
        side |= 1
    tilt = math.asin(math.sin(_TILT) * math.sqrt(rng.random()))
    turn, spin = rng.random(2) * 2 * math.pi
    to_camera = np.array([math.sin(tilt) * math.cos(turn), math.cos(tilt), math.sin(tilt) * math.sin(turn)])
    reach = 2 * _DISTANCE * math.tan(math.radians(_FIELD_OF_VIEW) / 2)  # what a picture shows of the plane, face on
    # The longer side of the footprint is that along the slope.
    texels = 2**lod * side / reach * math.cos(tilt)  # of a unit of the world
    height, width = (n / texels for n in size)  # of the maps in the world
    repeats = max(1, math.ceil(8 * reach / min(height, width)))  # enough that slanted pictures show no edge
    mesh = plane(width * repeats, height * repeats, (repeats, repeats)) if endless else plane(width, height)
    room = np.array([width, height]) - (0 if endless else reach)  # so that what is seen once is in the picture
    centre = (rng.random(2) - 0.5) * np.maximum(room, 0)
    looks_at = np.array([centre[0], 0.0, centre[1]])
    up = np.cross(np.cross(to_camera, [math.cos(spin), 0.3, math.sin(spin)]), to_camera)
    camera = Camera(
        _triple(looks_at + _DISTANCE * to_camera), _triple(looks_at), _triple(up), _FIELD_OF_VIEW, near=0.1, far=400.0
    )
    directions = [_near_mirror(to_camera, rng), *(_cosine(rng) for _ in range(_LIGHTS - 1))]
    radiance = np.pi / _LIGHTS * rng.uniform(0.5, 1.5, (_LIGHTS, 1)) * rng.uniform(0.7, 1.3, (_LIGHTS, 3))
    return View(
        f"view {index + 1} at level of detail {lod:g}",
        scale_of(lod),
        mesh,
        camera,
        directional(f"lights {index}", np.array(directions), radiance),
        (side, side),
    )


def _triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(component) for component in vector)
    return x, y, z


def _cosine(rng: np.random.Generator) -> NDArray[np.float64]:
    """A direction over the plane, cosine-distributed."""
    radius, turn = math.sqrt(rng.random()), rng.random() * 2 * math.pi
    return np.array([radius * math.cos(turn), math.sqrt(max(1 - radius**2, 1e-4)), radius * math.sin(turn)])


def _near_mirror(to_camera: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Near the mirror direction of the camera, above the plane."""
    mirrored = to_camera * [-1, 1, -1] + rng.normal(0, _NEAR_MIRROR, 3)
    mirrored[1] = max(mirrored[1], 0.05)
    return np.asarray(mirrored / np.linalg.norm(mirrored))
