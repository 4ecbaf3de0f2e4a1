"""A pinhole camera: 4 x 4 matrices from world to clip space, as `mipbake.raster` takes it.

The world is right-handed with +y up, as glTF's. Clip space is OpenGL's: the camera looks along its own -z, depth z/w
runs from -1 at the near plane to 1 at the far one, and row 0 of a raster image is the bottom one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.errors import UsageError

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """Where from and where to one looks.

    Args:
        position, looks_at: points in the world, not the same.
        up: the direction that shows upwards in the image, not along the view.
        field_of_view: vertical, between the centres of the lower and upper image edges, in degrees, 0 to 180 exclusive.
        near, far: distances along the view of what is seen, 0 < near < far.
        shift: pixels to the right and upwards by which the picture is moved, while the eye stays and looks the same
            way: a lens shift, exact in every pixel.

    Raises:
        UsageError: values that make no camera.
    """

    position: Vector
    looks_at: Vector = (0.0, 0.0, 0.0)
    up: Vector = (0.0, 1.0, 0.0)
    field_of_view: float = 40.0
    near: float = 0.05
    far: float = 200.0
    shift: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (*self.position, *self.looks_at, *self.up, self.field_of_view, self.near, self.far)
        if not all(math.isfinite(number) for number in numbers):
            raise UsageError("the camera has a value that is not finite: expected numbers")
        if not 0 < self.field_of_view < 180:
            raise UsageError(
                f"the camera's field of view is {self.field_of_view} degrees: expected 0 to 180, exclusive"
            )
        if not 0 < self.near < self.far:
            raise UsageError(
                f"the camera's near and far planes are {self.near} and {self.far}: expected 0 < near < far"
            )
        forward = np.subtract(self.looks_at, self.position)
        reach = float(np.linalg.norm(forward) * np.linalg.norm(self.up))
        if np.linalg.norm(np.cross(forward, self.up)) <= 1e-9 * reach:
            raise UsageError(
                f"the camera at {self.position} looks at {self.looks_at} along its up direction {self.up}: "
                "expected another point to look at, and another up direction"
            )

    def view_matrix(self) -> NDArray[np.float64]:
        """(4, 4): world to eye space, where the camera sits at 0 and looks along -z; a rotation and a translation."""
        back = _unit(np.subtract(self.position, self.looks_at))
        right = _unit(np.cross(self.up, back))
        rotation = np.stack([right, np.cross(back, right), back])
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = -rotation @ np.asarray(self.position, np.float64)
        return matrix

    def projection_matrix(self, aspect: float) -> NDArray[np.float64]:
        """(4, 4): eye to clip space for an image of `aspect` = width / height."""
        focal = 1 / math.tan(math.radians(self.field_of_view) / 2)
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1] = focal / aspect, focal
        matrix[2, 2] = (self.near + self.far) / (self.near - self.far)
        matrix[2, 3] = 2 * self.near * self.far / (self.near - self.far)
        matrix[3, 2] = -1
        return matrix

    def to_clip(
        self, points: ArrayLike, resolution: tuple[int, int], offset: tuple[float, float] = (0.0, 0.0)
    ) -> NDArray[np.float64]:
        """(V, 4) clip-space positions of (V, 3) points in an image of `resolution` (height, width).

        `offset` moves the sampling points of every pixel by (columns, rows) pixels: the image shows what lies that far
        to the right of, and above, each pixel's centre.
        """
        height, width = resolution
        points = np.asarray(points, np.float64)
        matrix = self.projection_matrix(width / height) @ self.view_matrix()
        clip = points @ matrix[:, :3].T + matrix[:, 3]
        clip[:, :2] -= clip[:, 3:] * (2 * np.add(offset, self.shift) / [width, height])
        return np.asarray(clip)


def orbit(
    distance: float, azimuth: float, elevation: float, looks_at: Vector = (0.0, 0.0, 0.0), field_of_view: float = 40.0
) -> Camera:
    """A camera that looks at a point from `distance`: `azimuth` degrees from +z towards +x, `elevation` up from there.

    At the elevations of 90 and -90 degrees, where +y is not an up direction, the up direction of neighbouring
    elevations is kept. Near and far planes leave room for a scene as deep as the distance, and for one of radius 1.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    offset = (math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e))
    up = (-math.sin(a) * math.sin(e), math.cos(e), -math.cos(a) * math.sin(e))
    x, y, z = (float(t + distance * o) for t, o in zip(looks_at, offset, strict=True))
    return Camera((x, y, z), looks_at, up, field_of_view, near=0.01 * distance, far=2 * distance + 2)


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(v / np.linalg.norm(v))
