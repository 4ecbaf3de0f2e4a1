"""The views that shipped renderers know: a mesh under a few lights, as a camera sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.render.camera import Camera
from mipbake.render.environment import Lighting
from mipbake.render.mesh import Mesh


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
