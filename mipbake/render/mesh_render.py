"""Renders of a textured mesh: the once-per-pixel candidate and its supersampled, pixel-filtered reference.

Both see the same primitives under the same lights. At every point the tangent frame is that of glTF 2.0: interpolated
normal and tangent, made orthonormal there, and the bitangent from the handedness; lights and the viewer are turned into
it, and the material is shaded in it. There are no shadows and no reflections between surfaces; both sides of a triangle
are drawn, and a side that faces away is black.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import raster, sampling, shading
from mipbake.errors import UsageError
from mipbake.prefilter.pixel_filter import Wrap, filter_named
from mipbake.render.camera import Camera
from mipbake.render.environment import Lighting
from mipbake.render.mesh import Mesh

Array = NDArray[np.float32]

_EVALUATIONS = 1 << 17  # shaded at a time: their directions, radiance and weights take 1.5 MiB each

_RESOLVED = 1e-4  # of the image's root mean square: a standard error that is as good as none

# As in mipbake.render.texture_space: Roberts' additive recurrence, here of one offset a pass for the whole image.
_PLASTIC = 1.32471795724474602596
_RECURRENCE = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])


@dataclass(frozen=True, eq=False)
class Frame:
    """A candidate render, rows from the top.

    Args:
        image: (H, W, 3) float32 linear radiance, 0 where nothing is.
        coverage: (H, W) bool, where the pixel's centre sees the mesh.
        uv: (H, W, 2) float32 texture coordinates there.
        lod: (H, W) float32 level of detail of the trilinear lookup, clamped to the levels that exist.
    """

    image: Array
    coverage: NDArray[np.bool_]
    uv: Array
    lod: Array


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference render, rows from the top: the mean of two independent, unbiased halves.

    Args:
        first, second: (H, W, 3) float32 linear radiance, black where nothing is.
        interior: (H, W) bool, where every sample saw the mesh. Elsewhere the pixel shows an edge, which a candidate
            does not antialias; what is said of textures is measured inside.
        passes: samples a pixel, both halves together.
        standard_error: estimated root mean square error of `image` over the interior, radiance.
        candidate_error: estimated root mean square error over the interior, radiance, of the candidate that comes
            closest.
        converged: whether standard_error is within the target, or so small that no measure resolves it (80 dB below
            the image); else the cap on passes came first.
    """

    first: Array
    second: Array
    interior: NDArray[np.bool_]
    passes: int
    standard_error: float
    candidate_error: float
    converged: bool

    @property
    def image(self) -> Array:
        """(H, W, 3) float32 linear radiance, the mean of the halves."""
        return np.asarray((self.first + self.second) / 2, np.float32)


@dataclass(frozen=True, eq=False)
class _Points:
    """What covered pixels see, P of them: `where` (H, W) bool from the bottom, and arrays of P."""

    where: NDArray[np.bool_]
    uv: NDArray[np.float64]
    uv_da: NDArray[np.float64]
    frame: Array  # (P, 3, 3): rows t, b, n in the world
    view: Array  # (P, 3) in the frame


def candidate(
    mesh: Mesh,
    camera: Camera,
    lighting: Lighting,
    levels: Sequence[Array],
    model: str,
    wrap: Wrap,
    resolution: tuple[int, int],
    anisotropic: bool = False,
    offset: tuple[float, float] = (0.0, 0.0),
) -> Frame:
    """What an unchanged engine shows: each pixel's centre, one trilinear lookup of the stack there, shaded once.

    Args:
        levels: (H_L, W_L, C) stored channels, finest first.
        model: the material model of the channels.
        resolution: (height, width) in pixels.
        anisotropic: average up to 16 trilinear lookups along the footprint, at the level of its minor axis (16x
            anisotropic filtering, as engines offer it). They are of the stored channels, shaded once all the same.
        offset: (columns, rows) of pixels, to the right and upwards, from the centre to the point that is shown.
    """
    points = _visible(mesh, camera, resolution, offset, derivatives=True)
    finest, *coarser = (np.asarray(level, np.float32)[None] for level in levels)
    texels = sampling.texture(
        finest,
        points.uv[None, None],
        points.uv_da[None, None],
        mip=coarser,
        filter_mode="anisotropic" if anisotropic else "linear-mipmap-linear",
        boundary_mode=wrap,
    )[0, 0]
    height, width = resolution
    image = np.zeros((height, width, 3), np.float32)
    image[points.where] = _lit(points, texels, model, lighting)
    uv, lod = np.zeros((height, width, 2), np.float32), np.zeros((height, width), np.float32)
    uv[points.where] = points.uv
    lod[points.where] = level_of_detail(points.uv_da, finest.shape[1:3]).clip(0, len(levels) - 1)
    return Frame(image[::-1], points.where[::-1], uv[::-1], lod[::-1])


def reference(
    mesh: Mesh,
    camera: Camera,
    lighting: Lighting,
    stored: Array,
    model: str,
    wrap: Wrap,
    resolution: tuple[int, int],
    pixel_filter: str,
    rng: np.random.Generator,
    candidates: Sequence[Frame],
    target: float = 0.1,
    min_passes: int = 32,
    max_passes: int = 4096,
    progress: Callable[[int, float], None] = lambda _passes, _ratio: None,
) -> Reference:
    """Supersampled render: the pixel filter's mean of level 0, interpolated bilinearly and shaded at each sample.

    A pass renders the whole image with one sub-pixel offset, importance-sampled from the filter. Either half takes its
    offsets from a low-discrepancy sequence under a random shift of its own. Passes go on until the standard error of
    the mean, estimated from the halves' difference, is at most `target` of the smallest error among the candidates, or
    10^-4 of the image's root mean square.

    Args:
        stored: (H, W, C) stored channels of level 0 of the source.
        candidates: the renders whose errors this is to resolve, at least one, all of the same view.
        target: standard error over the smallest of their errors, root mean squares over the interior.
        min_passes, max_passes: passes of both halves together, even numbers from 4 on.
        progress: called after every check with the passes so far and the standard error over the one wanted.

    Raises:
        UsageError: no candidate or one of another resolution, or numbers of passes that are no such.
    """
    height, width = resolution
    if not candidates:
        raise UsageError("a reference without candidates: expected the renders whose errors it is to resolve")
    for each in candidates:
        if each.image.shape[:2] != (height, width):
            raise UsageError(
                f"a candidate is {each.image.shape[1]} x {each.image.shape[0]} pixels: "
                f"expected the reference's {width} x {height}"
            )
    if min_passes % 2 or max_passes % 2 or not 4 <= min_passes <= max_passes:
        raise UsageError(f"passes run from {min_passes} to {max_passes}: expected even numbers from 4 on, in order")
    kernel = filter_named(pixel_filter)
    level = np.asarray(stored, np.float32)[None]
    shifts = rng.random((2, 2))
    sums, weights = np.zeros((2, height, width, 3)), np.zeros(2)
    seen = np.zeros((height, width), np.int64)
    done, until = 0, min_passes // 2
    while True:
        for index in range(done, until):
            for half, shift in enumerate(shifts):
                offset, sign = kernel.offsets((shift + index * _RECURRENCE) % 1.0)
                points = _visible(mesh, camera, resolution, (float(offset[0]), float(offset[1])), derivatives=False)
                texels = sampling.texture(level, points.uv[None, None], filter_mode="linear", boundary_mode=wrap)[0, 0]
                weight = float(sign.prod())
                sums[half][points.where] += weight * _lit(points, texels, model, lighting).astype(np.float64)
                weights[half] += weight
                seen += points.where
        done = until
        # Signed filters' weights sum to their count on average only. Dividing by their sum keeps a constant constant,
        # and is biased by the square of the sequence's error.
        first, second = (sums / weights[:, None, None, None])[:, ::-1].astype(np.float32)
        interior = seen[::-1] == 2 * done
        noise, error, signal = _errors(first, second, [each.image for each in candidates], interior)
        wanted = max(target * error, _RESOLVED * signal)
        converged = noise <= wanted
        progress(2 * done, noise / wanted if wanted > 0 else 0.0)
        if converged or 2 * done >= max_passes:
            return Reference(first, second, interior, 2 * done, noise, error, converged)
        # The error falls at least with the root of the number of passes; what seems needed, but no more than double.
        needed = int(np.ceil(done * min(2.0, max(1.1, (noise / wanted) ** 2))))
        until = min(needed, max_passes // 2)


def level_of_detail(uv_da: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """(P,): log2 of the longer axis, in texels of a level of `size` (height, width), of footprints (P, 4).

    The derivatives are du/dX, du/dY, dv/dX, dv/dY per pixel, as `sampling.texture` takes them.
    """
    ux, uy, vx, vy = (np.asarray(uv_da) * [size[1], size[1], size[0], size[0]]).T
    # The larger singular value of [[ux, uy], [vx, vy]].
    half, cross = (ux**2 + vx**2 + uy**2 + vy**2) / 2, ux * uy + vx * vy
    major2 = half + np.hypot((ux**2 + vx**2 - uy**2 - vy**2) / 2, cross)
    return np.asarray(0.5 * np.log2(np.maximum(major2, 1e-300)))


def _errors(
    first: Array, second: Array, images: Sequence[Array], interior: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Root mean squares over the interior: of the halves' mean's error, the smallest of `images`', and of radiance."""
    if not interior.any():
        return 0.0, 0.0, 0.0
    a, b = (each[interior].astype(np.float64) for each in (first, second))
    noise = float(np.mean((a - b) ** 2)) / 4
    # The halves' errors are independent, so that they drop out of these products on average.
    error = min(float(np.mean((image[interior] - a) * (image[interior] - b))) for image in images)
    return float(np.sqrt(noise)), float(np.sqrt(max(error, 0.0))), float(np.sqrt(np.mean(((a + b) / 2) ** 2)))


def _visible(
    mesh: Mesh, camera: Camera, resolution: tuple[int, int], offset: tuple[float, float], derivatives: bool
) -> _Points:
    clip: Any = camera.to_clip(mesh.positions, resolution, offset)[None]
    triangles: Any = mesh.triangles
    rast, rast_db = raster.rasterize(None, clip, triangles, resolution)
    where = rast[0, ..., 3] > 0
    attributes: Any = np.concatenate([mesh.normals, mesh.tangents, mesh.positions, mesh.uv], -1)
    if derivatives:
        image, image_da = raster.interpolate(attributes, rast, triangles, rast_db, diff_attrs=[10, 11])
    else:
        image, image_da = raster.interpolate(attributes, rast, triangles)
    values = image[0][where]
    n = _unit(values[:, 0:3])
    t = _unit(values[:, 3:6] - (values[:, 3:6] * n).sum(-1, keepdims=True) * n)
    b = np.cross(n, t) * np.sign(values[:, 6:7])
    frame = np.stack([t, b, n], 1)
    to_eye = _unit(np.asarray(camera.position) - values[:, 7:10])
    view = np.einsum("pij,pj->pi", frame, to_eye)
    return _Points(where, values[:, 10:12], image_da[0][where], frame.astype(np.float32), view.astype(np.float32))


def _lit(points: _Points, texels: Array, model: str, lighting: Lighting) -> Array:
    """(P, 3) float32 radiance towards the camera, of all lights together."""
    x, y, z = lighting.direction.astype(np.float32).T[..., None]
    out = np.empty((len(texels), 3), np.float32)
    step = min(max(64, _EVALUATIONS // len(lighting.direction)), max(len(texels), 1))
    radiance = np.tile(lighting.radiance.astype(np.float32), step)
    # Plain sums, no matrix products: a BLAS library's threads would wait on those of shading, and these on them.
    light, part = np.empty_like(radiance), np.empty_like(radiance)
    for start in range(0, len(texels), step):
        some = slice(start, start + step)
        each = points.frame[some].reshape(-1, 3).T
        used = slice(0, each.shape[1])
        np.multiply(x, each[0], out=light[:, used])
        light[:, used] += np.multiply(y, each[1], out=part[:, used])
        light[:, used] += np.multiply(z, each[2], out=part[:, used])
        directions = light[:, used].reshape(1, len(light), -1, 3)
        f = shading.shade(model, texels[some], directions, np.broadcast_to(points.view[some], directions.shape))
        lit = f.reshape(len(light), -1)
        lit *= radiance[:, used]
        out[some] = lit.sum(0).reshape(-1, 3)
    return out


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(v / np.where(length > 0, length, 1))
