"""Renders of a textured mesh: the once-per-pixel candidate and its supersampled, pixel-filtered reference, and films.

Both see the same primitives under the same lights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.timings import Progress
from mipbake.comparing.meshes.supersampling import Supersampling
from mipbake.comparing.meshes.visible import Points, Shot, lit
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap
from mipbake.quality.samplers import RenderSampler, level_of_detail, look_up, over_frames

__all__ = ["Frame", "Reference", "Shot", "candidate", "film_candidate", "reference"]

Array = NDArray[np.float32]

_RESOLVED = 1e-4  # share of the image's root mean square: a standard error that is as good as none


@dataclass(frozen=True, eq=False)
class Frame:
    """A candidate render, rows from the top.

    Args:
        image: (H, W, 3) float32 linear radiance, 0 where nothing is.
        coverage: (H, W) bool, where the pixel's centre sees the mesh.
        uv: (H, W, 2) float32 texture coordinates there.
        lod: (H, W) float32 level of detail of a trilinear lookup, by the longer axis of the footprint, clamped to the
            levels that exist. Anisotropic lookups take finer levels, up to 4 less.
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
        converged: whether standard_error is within the wanted share, or so small that no measure resolves it (80 dB
            below the image); else the cap on passes came first.
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


def candidate(
    shot: Shot,
    levels: Sequence[Array],
    model: str,
    wrap: Wrap,
    sampler: RenderSampler = DEFAULT_SAMPLER,
    offset: tuple[float, float] = (0.0, 0.0),
    rng: np.random.Generator | None = None,
) -> Frame:
    """What an unchanged engine shows: each pixel's centre, looked up and shaded once; or the mean of as many frames as
    the sampler has, each at a point of its own.

    Args:
        levels: (H_L, W_L, C) stored channels, finest first.
        model: the material model of the channels.
        sampler: how the stack is looked up.
        offset: (columns, rows) of pixels, to the right and upwards, from the centre to the point that is shown.
        rng: what the stochastic sampler draws with.
    """
    surface = shot.surface
    points = surface.seen(offset)
    height, width = shot.resolution

    def image(values: NDArray[Any], dtype: type, points: Points = points) -> NDArray[Any]:
        whole = np.zeros((height * width, *values.shape[1:]), dtype)
        whole[points.index] = values
        return whole.reshape(height, width, *values.shape[1:])[::-1]

    def frame(shift: tuple[float, float]) -> Array:
        seen = surface.seen((offset[0] + shift[0], offset[1] + shift[1])) if any(shift) else points
        texels = look_up(levels, seen.uv, seen.uv_da, wrap, sampler, rng)
        return image(lit(seen, texels, model, shot.lighting), np.float32, seen)

    lod = level_of_detail(points.uv_da, levels[0].shape[:2]).clip(0, len(levels) - 1)
    return Frame(
        over_frames(sampler, frame),
        image(np.ones(len(points.uv)), np.bool_),
        image(points.uv, np.float32),
        image(lod, np.float32),
    )


def film_candidate(
    shots: Sequence[Shot],
    levels: Sequence[Array],
    model: str,
    wrap: Wrap,
    sampler: RenderSampler = DEFAULT_SAMPLER,
    seed: int = 0,
) -> Array:
    """(T, H, W, 3): what an unchanged engine shows, frame after frame; arguments as of `candidate`.

    The stochastic sampler draws every frame anew, from `seed` on.
    """
    rng = np.random.default_rng(seed)
    return np.stack([candidate(shot, levels, model, wrap, sampler, rng=rng).image for shot in shots])


def reference(
    shot: Shot,
    source: FilteredSource,
    seed: int,
    candidates: Sequence[Frame],
    resolved_share: float = 0.1,
    least: int = 32,
    most: int = 4096,
    progress: Progress = lambda _share: None,
    cache: Path | None = None,
) -> Reference:
    """The supersampled render, `Supersampling` on the screen, where a pixel can cover an outline and several surfaces.

    The estimator of `mipbake.quality.reference` draws its samples in texture space, where there are none. Passes go on
    until the standard error of the mean, estimated from the halves' difference, is at most `resolved_share` of the
    smallest error among the candidates, or 10^-4 of the image's root mean square; errors are root mean squares over the
    interior. No candidate has a say in what a pass renders.

    Args:
        seed: of the samples, not negative.
        candidates: the renders whose errors this is to resolve, at least one, all of the same view.
        least, most: samples a pixel, of both halves together; even numbers from 4 on.
        cache: folder where passes are kept; None keeps none. Passes found there count, also beyond `most`.
    """
    rendering = Supersampling([shot], source, seed, cache)

    def judged() -> tuple[Reference, float]:
        first, second, interior = (each[0] for each in rendering.halves())
        noise, error, signal = _errors(first, second, [each.image for each in candidates], interior)
        wanted = max(resolved_share * error, _RESOLVED * signal)
        converged = noise <= wanted
        found = Reference(first, second, interior, rendering.passes, noise, error, converged)
        return found, 0.0 if converged else noise / max(wanted, 1e-300)

    return rendering.resolve(least, most, 1.1, judged, progress)


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
