"""Temporal accumulation, as most engines have it: jittered cameras, and an exponential average over frames.

Each frame is rendered once per pixel, at a point of the pixel that changes from frame to frame. The history, what was
shown one frame before, is looked up where the surface was seen then, held to the colours of the new frame around the
pixel, and mixed with the new frame (Karis 2014, High-Quality Temporal Supersampling; Yang et al. 2020, A Survey of
Temporal Antialiasing Techniques, sections 3 and 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import raster
from mipbake._extras import extra
from mipbake.pixel_filter import Wrap
from mipbake.render.camera import Camera
from mipbake.render.film import Film, Frames
from mipbake.render.mesh_render import Shot, candidate
from mipbake.render.samplers import Sampler

JITTERS = 8
"""Points of the pixel that frames go through, a Halton sequence in bases 2 and 3, as Unreal Engine has it."""

NEW = 0.1
"""Share of the new frame in what is shown. 0.04 to 0.1 are common; a guess within that."""

_ROUNDING = 1e-6  # of depths, of which single floats take part
_HELD = 1  # pixels around a pixel whose colours, and depths, its history is held to
_USER = "a film with temporal accumulation"


def film_accumulated(
    film: Film,
    levels: Sequence[NDArray[np.float32]],
    model: str,
    wrap: Wrap,
    sampler: Sampler = "trilinear",
    seed: int = 0,
) -> Frames:
    """(T, H, W, 3) linear radiance: what an engine with temporal accumulation shows, frame after frame.

    The history of the first frame is the mean of JITTERS renders of it: a camera that had stood still there would have
    come to it. Mixing and holding take the tonemapped radiance x / (1 + x), so that single bright pixels do not flicker
    (Karis 2014). Arguments as `mipbake.render.film.film_candidate`.
    """
    rng = np.random.default_rng(seed)
    offsets = jitter(JITTERS)
    shots = film.shots

    def rendered(shot: Shot, index: int) -> NDArray[np.float64]:
        x, y = offsets[index % JITTERS]
        image = candidate(shot, levels, model, wrap, sampler, (float(x), float(y)), rng).image.astype(np.float64)
        return np.asarray(image / (1 + image))

    history = np.mean([rendered(shots[0], index) for index in range(JITTERS)], 0)
    shown = []
    for index, shot in enumerate(shots):
        new = rendered(shot, index)
        if index:
            history = moved(history, shot, film.cameras[index - 1], new)
        history = NEW * new + (1 - NEW) * held(history, new)
        shown.append(history / (1 - history))
    return np.stack(shown).astype(np.float32)


def jitter(count: int) -> NDArray[np.float64]:
    """(count, 2) offsets from the pixel's centre, within half a pixel: Halton points of the bases 2 and 3."""
    return np.stack([[_radical_inverse(index, base) for base in (2, 3)] for index in range(1, count + 1)]) - 0.5


def _radical_inverse(index: int, base: int) -> float:
    inverse, scale = 0.0, 1.0
    while index:
        scale /= base
        index, digit = divmod(index, base)
        inverse += digit * scale
    return inverse


def moved(history: NDArray[np.float64], shot: Shot, before: Camera, new: NDArray[np.float64]) -> NDArray[np.float64]:
    """The history where each pixel's surface was seen by the camera of the frame before, interpolated by cubic splines;
    the new frame where nothing is, and where the surface lay outside of the picture or behind another one."""
    with extra("compare", _USER):
        from scipy.ndimage import map_coordinates

    height, width = shot.resolution
    clip: Any = shot.camera.to_clip(shot.mesh.positions, shot.resolution)[None]
    then: Any = before.to_clip(shot.mesh.positions, shot.resolution)
    triangles: Any = shot.mesh.triangles
    rast, _ = raster.rasterize(None, clip, triangles, shot.resolution)
    was = raster.interpolate(then, rast, triangles)[0][0][::-1]
    covered = rast[0, ::-1, :, 3] > 0
    w = np.where(covered, was[..., 3], 1)
    column = (was[..., 0] / w + 1) / 2 * width - 0.5
    row = (1 - was[..., 1] / w) / 2 * height - 0.5
    inside = covered & (np.abs(column - (width - 1) / 2) <= width / 2) & (np.abs(row - (height - 1) / 2) <= height / 2)
    at = np.stack([row, column])
    inside &= _was_seen(w, at, then, triangles, shot.resolution)
    shifted = np.stack([map_coordinates(history[..., c], at, order=3, mode="nearest") for c in range(3)], -1)
    return np.where(inside[..., None], shifted, new)


def _was_seen(
    depth: NDArray[np.float64], at: NDArray[np.float64], then: Any, triangles: Any, resolution: tuple[int, int]
) -> NDArray[np.bool_]:
    """(H, W): whether surfaces were in front in the frame before, by the depths that were seen around them then.

    A surface may lie behind these by as much as they vary, so that slanted surfaces hide nothing of their own.

    Args:
        depth: (H, W) clip-space w that each pixel's surface had. at: (2, H, W) rows and columns where it lay.
        then: (N, 4) vertices in clip space.
    """
    with extra("compare", _USER):
        from scipy.ndimage import maximum_filter, minimum_filter

    rast, _ = raster.rasterize(None, then[None], triangles, resolution)
    covered = rast[0, ::-1, :, 3] > 0
    seen = np.where(covered, raster.interpolate(then, rast, triangles)[0][0][::-1][..., 3], np.inf)
    near, far = (extreme(seen, 2 * _HELD + 1, mode="nearest") for extreme in (minimum_filter, maximum_filter))
    behind = far + np.subtract(far, near, out=np.zeros_like(far), where=np.isfinite(far))
    row, column = (np.clip(np.rint(each), 0, side - 1).astype(int) for each, side in zip(at, resolution, strict=True))
    return np.asarray(depth <= (1 + _ROUNDING) * behind[row, column])


def held(history: NDArray[np.float64], new: NDArray[np.float64]) -> NDArray[np.float64]:
    """The history, no darker and no brighter than the new frame around each pixel, by channel."""
    with extra("compare", _USER):
        from scipy.ndimage import maximum_filter, minimum_filter

    size = (2 * _HELD + 1, 2 * _HELD + 1, 1)
    return np.clip(history, minimum_filter(new, size, mode="nearest"), maximum_filter(new, size, mode="nearest"))
