"""Triangle meshes with what texturing needs: normals, texture coordinates and tangent frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in the world, right-handed with +y up.

    Args:
        name: what messages call it.
        positions: (V, 3) float64.
        normals: (V, 3) float64, unit vectors.
        uv: (V, 2) float64, v pointing down in the image.
        tangents: (V, 4) float64: a unit vector normal to the normal, along growing u; and the handedness w, 1 or -1.
            The bitangent w (n x t) points towards smaller v, upwards in the image (glTF 2.0, section 3.7.2.1).
        triangles: (T, 3) int32.

    Raises:
        InputError: on construction, when shapes do not fit, a value is not finite, an index leads nowhere, or there is
            no triangle.
    """

    name: str
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64]
    tangents: NDArray[np.float64]
    triangles: NDArray[np.int32]

    def __post_init__(self) -> None:
        count = len(self.positions)
        if self.triangles.ndim != 2 or self.triangles.shape[1:] != (3,) or len(self.triangles) == 0:
            raise InputError(f"mesh {self.name} has no triangles: expected at least one")
        for what, width in (("positions", 3), ("normals", 3), ("uv", 2), ("tangents", 4)):
            array = getattr(self, what)
            if array.shape != (count, width):
                raise InputError(f"mesh {self.name}: {what} have shape {array.shape}, expected ({count}, {width})")
            if not np.isfinite(array).all():
                raise InputError(f"mesh {self.name}: {what} hold a value that is not finite, expected numbers")
        if self.triangles.min() < 0 or self.triangles.max() >= count:
            raise InputError(f"mesh {self.name}: a triangle refers to a vertex beyond its {count} vertices")

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Smallest and largest coordinates, (3,) each, of the vertices that triangles use."""
        used = self.positions[self.triangles.reshape(-1)]
        return used.min(0), used.max(0)


def joined(name: str, meshes: list[Mesh]) -> Mesh:
    """One mesh of several, in order."""
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes[:-1])])
    fields = ("positions", "normals", "uv", "tangents")
    positions, normals, uv, tangents = (np.concatenate([getattr(each, field) for each in meshes]) for field in fields)
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(name, positions, normals, uv, tangents, np.concatenate(triangles).astype(np.int32))
