"""What the pixels of an image see of a mesh: texture coordinates, tangent frames and directions to the viewer.

At every point the tangent frame follows glTF 2.0: interpolated normal and tangent, made orthonormal there, and the
bitangent from the handedness. There are no shadows and no reflections between surfaces; both sides of a triangle are
drawn, and a side that faces away is black.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import raster, shading
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.quality.environment import Lighting

BAND = 1 << 14
"""Pixels at a time. Their arrays stay in the cache, and are small enough that the allocator keeps their memory: pages
that come back from the system cost more than what is computed in them."""

_NORMAL, _TANGENT = slice(0, 3), slice(3, 7)  # slices of the attributes, where a mesh is not flat
_TO_EYE, _UV = slice(-5, -2), slice(-2, None)


@dataclass(frozen=True, eq=False)
class Points:
    """What P covered pixels see.

    Args:
        index: (P,) which pixels, counted along rows from the bottom one.
        uv: (P, 2) float64 texture coordinates.
        uv_da: (P, 4) float64, du/dX, du/dY, dv/dX, dv/dY per pixel, as `sampling.texture` takes them; or (P, 0).
        frame: (P, 3, 3) float32, the tangent frame: rows t, b, n in the world.
        view: (P, 3) float32, unit vectors to the camera, in the world.
    """

    index: NDArray[np.intp]
    uv: NDArray[np.float64]
    uv_da: NDArray[np.float64]
    frame: NDArray[np.float32]
    view: NDArray[np.float32]


class Surface:
    """A mesh as a camera sees it in images of `resolution` (height, width): what all of them share is kept."""

    def __init__(self, mesh: Mesh, camera: Camera, resolution: tuple[int, int]) -> None:
        self._triangles: Any = mesh.triangles
        self._mesh, self._camera, self._resolution = mesh, camera, resolution
        to_eye = np.asarray(camera.position) - mesh.positions  # linear in the position, so it interpolates as that does
        directions = np.concatenate([mesh.normals, mesh.tangents], -1)
        self._flat = _frames(directions[:1]) if (directions == directions[:1]).all() else None
        varying = [directions] if self._flat is None else []
        self._attributes: Any = np.concatenate([*varying, to_eye, mesh.uv], -1)

    def seen(self, offset: tuple[float, float] = (0.0, 0.0)) -> Points:
        """What all pixels see, with derivatives, at an offset of (columns, rows) from their centres."""
        rast, rast_db = self._rasterized(offset)
        count = self._attributes.shape[-1]
        uv_channels = [count - 2, count - 1]
        image, image_da = raster.interpolate(self._attributes, rast, self._triangles, rast_db, diff_attrs=uv_channels)
        return _points(rast[0], image[0], image_da[0], 0, self._flat)

    def bands(self, offset: tuple[float, float]) -> Iterator[Points]:
        """The same without derivatives, some rows at a time, so that no image needs much memory at once."""
        rast, _ = self._rasterized(offset)
        height, width = self._resolution
        rows = max(1, BAND // width)
        for row in range(0, height, rows):
            band: Any = rast[:, row : row + rows]
            image, image_da = raster.interpolate(self._attributes, band, self._triangles)
            yield _points(band[0], image[0], image_da[0], row * width, self._flat)

    def _rasterized(self, offset: tuple[float, float]) -> tuple[Any, Any]:
        clip: Any = self._camera.to_clip(self._mesh.positions, self._resolution, offset)[None]
        return raster.rasterize(None, clip, self._triangles, self._resolution)


@dataclass(frozen=True, eq=False)
class Shot:
    """What is rendered: a mesh under lights, as a camera sees it. resolution: (height, width) in pixels."""

    mesh: Mesh
    camera: Camera
    lighting: Lighting
    resolution: tuple[int, int]

    @property
    def surface(self) -> Surface:
        """What of the mesh each pixel sees."""
        return Surface(self.mesh, self.camera, self.resolution)


def lit(points: Points, texels: NDArray[np.float32], model: str, lighting: Lighting) -> NDArray[np.float32]:
    """(P, 3) float32 radiance towards the camera, of all lights together; texels: (P, C) stored channels of `model`."""
    made: NDArray[np.float32] = shading.shade_lit(
        model, texels, points.frame, points.view, lighting.direction, lighting.radiance
    )
    return made


def _points(
    rast: NDArray[Any], image: NDArray[Any], image_da: NDArray[Any], first: int, flat: NDArray[np.float32] | None
) -> Points:
    """The points of rows of an image from pixel `first` on: (h, W, 4) of `raster.rasterize`, (h, W, .) interpolated.

    Args:
        flat: (1, 3, 3), the frame of a mesh that has one alone; its attributes are without normals and tangents.
    """
    seen = rast[..., 3] > 0
    covered, whole = np.flatnonzero(seen), bool(seen.all())

    def of(pixels: NDArray[Any]) -> NDArray[Any]:
        rows = pixels.reshape(len(rast) * rast.shape[1], pixels.shape[-1])
        return rows if whole else rows.take(covered, axis=0)

    values = of(image)
    frame = _frames(values[:, : _TANGENT.stop]) if flat is None else np.broadcast_to(flat, (len(covered), 3, 3))
    view = values[:, _TO_EYE].T.astype(np.float32, order="C")
    _normalise(view)
    return Points(covered + first, values[:, _UV], of(image_da), frame, view.T)


def _frames(directions: NDArray[Any]) -> NDArray[np.float32]:
    """(P, 3, 3) orthonormal frames of (P, 7) normals and tangents.

    Directions a component at a time, in float32: that is what shading takes, and a fraction of the time.
    """
    planes = directions.T.astype(np.float32, order="C")
    frame = np.empty((3, 3, len(directions)), np.float32)
    t, b, n = frame
    n[:] = planes[_NORMAL]
    _normalise(n)
    x, y, z, handedness = planes[_TANGENT]
    along = x * n[0] + y * n[1] + z * n[2]
    for to, component, normal in zip(t, (x, y, z), n, strict=True):
        np.subtract(component, along * normal, out=to)
    _normalise(t)
    side = np.sign(handedness)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(n[j] * t[k] - n[k] * t[j], side, out=b[i])
    axes: NDArray[np.float32] = frame.transpose(2, 0, 1)
    return axes


def _normalise(planes: NDArray[np.float32]) -> None:
    """Scales (3, P) vectors to unit length; vectors of length 0 stay as they are."""
    length = np.sqrt(planes[0] * planes[0] + planes[1] * planes[1] + planes[2] * planes[2])
    planes *= 1 / np.where(length > 0, length, 1)
