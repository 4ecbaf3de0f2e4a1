"""Renders of a textured mesh: the once-per-pixel candidate and its supersampled, pixel-filtered reference.

Both see the same primitives under the same lights. At every point the tangent frame follows glTF 2.0: interpolated
normal and tangent, made orthonormal there, and the bitangent from the handedness; the material is shaded in it. There
are no shadows and no reflections between surfaces; both sides of a triangle are drawn, and a side that faces away is
black.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling, shading
from mipbake.base.errors import UsageError
from mipbake.base.version import __version__
from mipbake.comparing.meshes import cache as caches
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.visible import Points, Surface
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import PixelFilter, Wrap, filter_named
from mipbake.quality.environment import Lighting
from mipbake.quality.reference.sequences import SEQUENCE
from mipbake.quality.samplers import RenderSampler, level_of_detail, look_up, over_frames

Array = NDArray[np.float32]

FORMAT = 1
"""Version of what a pass renders; to be raised whenever a pass renders anything else."""

_RESOLVED = 1e-4  # share of the image's root mean square: a standard error that is as good as none


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


@dataclass(frozen=True)
class Passes:
    """How long a reference is rendered, and how often it says how far it is.

    Args:
        resolved_share: the standard error that is small enough, as a share of the smallest error of a candidate; both
            are root mean squares over the interior.
        least, most: passes of both halves together, even numbers from 4 on.
        heard_every: seconds between two calls of `progress`, at most, as far as half a pass takes no longer.

    Raises:
        UsageError: other numbers of passes.
    """

    resolved_share: float = 0.1
    least: int = 32
    most: int = 4096
    heard_every: float = 0.25

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.least % 2 or self.most % 2 or not 4 <= self.least <= self.most:
            raise UsageError(f"passes run from {self.least} to {self.most}: expected even numbers from 4 on, in order")


@dataclass(frozen=True)
class Cache:
    """Where passes are kept, by content (`mipbake.comparing.meshes.cache`).

    Args:
        folder: holds the files; made where it is missing.
        saved_every: seconds of rendering that a reference which is stopped may lose.
        version, format: of the program and of what its passes render. Passes of another version, or of another format,
            are not continued.
    """

    folder: Path
    saved_every: float = 10.0
    version: str = __version__
    format: int = FORMAT


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
        converged: whether standard_error is within the share that was asked for, or so small that no measure resolves
            it (80 dB below the image); else the cap on passes came first.
        resumed: how many of the passes came from the cache.
        cache_note: why the passes could not be cached, in a sentence, where they were to be; else empty.
    """

    first: Array
    second: Array
    interior: NDArray[np.bool_]
    passes: int
    standard_error: float
    candidate_error: float
    converged: bool
    resumed: int = 0
    cache_note: str = ""

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
    points = shot.surface.seen(offset)
    height, width = shot.resolution

    def image(values: NDArray[Any], dtype: type, points: Points = points) -> NDArray[Any]:
        whole = np.zeros((height * width, *values.shape[1:]), dtype)
        whole[points.index] = values
        return whole.reshape(height, width, *values.shape[1:])[::-1]

    def frame(shift: tuple[float, float]) -> Array:
        seen = shot.surface.seen((offset[0] + shift[0], offset[1] + shift[1])) if any(shift) else points
        texels = look_up(levels, seen.uv, seen.uv_da, wrap, sampler, rng)
        return image(_lit(seen, texels, model, shot.lighting), np.float32, seen)

    lod = level_of_detail(points.uv_da, levels[0].shape[:2]).clip(0, len(levels) - 1)
    return Frame(
        over_frames(sampler, frame),
        image(np.ones(len(points.uv)), np.bool_),
        image(points.uv, np.float32),
        image(lod, np.float32),
    )


def reference(
    shot: Shot,
    source: FilteredSource,
    seed: int,
    candidates: Sequence[Frame],
    passes: Passes = Passes(),
    progress: Callable[[int, float], None] = lambda _passes, _ratio: None,
    cache: Cache | None = None,
) -> Reference:
    """Supersampled render: the pixel filter's mean of level 0, interpolated bilinearly and shaded at each sample.

    It supersamples meshes on the screen, where a pixel can cover a silhouette and several surfaces; the estimator of
    `mipbake.quality.reference` draws its samples in texture space, where there are none.

    A pass renders the whole image with one sub-pixel offset, importance-sampled from the filter. Either half takes its
    offsets from a low-discrepancy sequence under a random shift of its own. Passes go on until the standard error of
    the mean, estimated from the halves' difference, is at most `passes.resolved_share` of the smallest error among the
    candidates, or 10^-4 of the image's root mean square.

    The result depends on the arguments, and on the passes that a cache already holds: no candidate has a say in what a
    pass renders, so a reference of a number of passes is the same bits however often it was stopped and resumed.

    Args:
        seed: of the samples, not negative.
        candidates: the renders whose errors this is to resolve, at least one, all of the same view.
        passes: how long it is rendered.
        progress: called with the passes so far and the standard error over the one wanted, after every check, and in
            between as `passes` says. There the ratio is extrapolated from the last check with the root of the number
            of passes, and infinite before the first.
        cache: where passes are kept; None keeps none. Passes found there count, also beyond `passes.most`, and what is
            rendered more is saved.

    Raises:
        UsageError: no candidate or a candidate of another resolution, or a seed outside its range.
    """
    height, width = shot.resolution
    if not candidates:
        raise UsageError("a reference without candidates: expected the renders whose errors it is to resolve")
    for each in candidates:
        if each.image.shape[:2] != (height, width):
            raise UsageError(
                f"a candidate is {each.image.shape[1]} x {each.image.shape[0]} pixels: "
                f"expected the reference's {width} x {height}"
            )
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise UsageError(f"the seed of a reference is {seed!r}: expected an integer that is not negative")

    key = "" if cache is None else reference_key([shot], source, seed, cache)
    state = Supersampled.restored(caches.load(cache.folder, key) if cache else None, shot.resolution, seed)
    resumed, note = state.done, ""
    render = SamplePass.of(shot, source)
    images = [each.image for each in candidates]
    heard = saved = time.monotonic()
    ratio, checked, until = np.inf, 1, max(state.done, passes.least // 2)
    while True:
        while state.done < until:
            for half in range(2):
                render.add(state, half)
                if time.monotonic() - heard >= passes.heard_every:
                    done = 2 * state.done + half + 1
                    progress(done, float(ratio * np.sqrt(2 * checked / done)))
                    heard = time.monotonic()
            state.done += 1
        first, second, interior = state.result()
        noise, error, signal = _errors(first, second, images, interior)
        wanted = max(passes.resolved_share * error, _RESOLVED * signal)
        converged = noise <= wanted
        ratio, checked, heard = noise / wanted if wanted > 0 else 0.0, state.done, time.monotonic()
        finished = converged or 2 * state.done >= passes.most
        if cache is not None and state.done > resumed and (finished or heard - saved >= cache.saved_every):
            note, saved = caches.save(cache.folder, key, state.arrays()), time.monotonic()
        progress(2 * state.done, ratio)
        if finished:
            return Reference(first, second, interior, 2 * state.done, noise, error, converged, 2 * resumed, note)
        # The error falls at least with the root of the number of passes; what seems needed, but no more than double.
        needed = int(np.ceil(state.done * min(2.0, max(1.1, ratio**2))))
        until = min(needed, passes.most // 2)


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


@dataclass(eq=False)
class Supersampled:
    """How far the reference of a picture is; rows from the bottom, and two of a kind for the two halves.

    Args:
        sums: (2, H W, 3) float64 weighted radiance.
        weights: (2,) float64, theirs.
        seen: (H W,) int32, how many samples of both halves saw the mesh.
        shifts: (2, 2) float64 of the sequences of offsets.
        done: passes of each half.
    """

    sums: NDArray[np.float64]
    weights: NDArray[np.float64]
    seen: NDArray[np.int32]
    shifts: NDArray[np.float64]
    done: int
    resolution: tuple[int, int]

    @staticmethod
    def restored(arrays: dict[str, NDArray[Any]] | None, resolution: tuple[int, int], seed: int) -> Supersampled:
        """What `arrays` hold if they are a state of this kind; else that before the first pass."""
        pixels = resolution[0] * resolution[1]
        start = Supersampled(
            np.zeros((2, pixels, 3)), np.zeros(2), np.zeros(pixels, np.int32),
            np.random.default_rng(seed).random((2, 2)), 0, resolution,
        )  # fmt: skip
        if arrays is None:
            return start
        for name, fresh in start.arrays().items():
            if name not in arrays or arrays[name].shape != fresh.shape or arrays[name].dtype != fresh.dtype:
                return start
        done = int(arrays["done"])
        whole = all(np.isfinite(arrays[name]).all() for name in ("sums", "weights"))
        if not whole or done < 2 or not np.array_equal(arrays["shifts"], start.shifts):
            return start
        return Supersampled(arrays["sums"], arrays["weights"], arrays["seen"], start.shifts, done, resolution)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What a cache keeps of it."""
        return {
            "sums": self.sums,
            "weights": self.weights,
            "seen": self.seen,
            "shifts": self.shifts,
            "done": np.array(self.done, np.int64),
        }

    def result(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The halves, and the interior; rows from the top."""
        # Signed filters' weights sum to their count on average only. Dividing by their sum keeps a constant constant,
        # and is biased by the square of the sequence's error.
        halves = (self.sums / self.weights[:, None, None]).astype(np.float32).reshape(2, *self.resolution, 3)
        interior = (self.seen == 2 * self.done).reshape(self.resolution)
        return halves[0, ::-1], halves[1, ::-1], interior[::-1]


@dataclass(frozen=True, eq=False)
class SamplePass:
    """What every pass over a picture renders, except for its offset."""

    surface: Surface
    lighting: Lighting
    level: Array  # (1, H, W, C)
    model: str
    wrap: Wrap
    kernel: PixelFilter

    @staticmethod
    def of(shot: Shot, source: FilteredSource) -> SamplePass:
        """The passes over a shot."""
        level = np.ascontiguousarray(source.stored, np.float32)[None]
        kernel = filter_named(source.pixel_filter)
        return SamplePass(shot.surface, shot.lighting, level, source.model, source.wrap, kernel)

    def add(self, state: Supersampled, half: int) -> None:
        """Adds the next pass of a half to its sums."""
        offset, sign = self.kernel.offsets((state.shifts[half] + state.done * SEQUENCE) % 1.0)
        weight = float(sign.prod())
        for points in self.surface.bands((float(offset[0]), float(offset[1]))):
            texels = sampling.texture(self.level, points.uv[None, None], filter_mode="linear", boundary_mode=self.wrap)[
                0, 0
            ]
            lit = _lit(points, texels, self.model, self.lighting)
            state.sums[half, points.index] += weight * lit.astype(np.float64)
            state.seen[points.index] += 1
        state.weights[half] += weight


def _lit(points: Points, texels: Array, model: str, lighting: Lighting) -> Array:
    """(P, 3) float32 radiance towards the camera, of all lights together."""
    lit: Array = shading.shade_lit(model, texels, points.frame, points.view, lighting.direction, lighting.radiance)
    return lit


def reference_key(shots: Sequence[Shot], source: FilteredSource, seed: int, cache: Cache) -> str:
    """Names by content what the passes over the shots of one mesh, in one resolution, depend on."""
    mesh = shots[0].mesh
    cameras = (np.ravel(np.asarray(field, np.float64)) for shot in shots for field in astuple(shot.camera))
    return caches.content_key(
        format=cache.format,
        version=cache.version,
        mesh=(mesh.positions, mesh.normals, mesh.uv, mesh.tangents, mesh.triangles),
        camera=np.concatenate(list(cameras)),
        lighting=tuple(array for shot in shots for array in (shot.lighting.direction, shot.lighting.radiance)),
        level=np.asarray(source.stored, np.float32),
        model=source.model,
        wrap=tuple(source.wrap),
        resolution=tuple(int(size) for size in shots[0].resolution),
        pixel_filter=source.pixel_filter,
        seed=int(seed),
    )
