"""Two plots of Kemppinen et al. 2023, "Pixel filter aware MIP maps", for any material: temporal slice (figure 4) and
apparent BRDF (figure 8). The change under a half-pixel shift (figure 6) comes with renders (pictures.py)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import shading
from mipbake.base.timings import Progress
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.pictures import RenderSettings, brightening
from mipbake.comparing.result import Image, Plot
from mipbake.comparing.scenes import exposed
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap, filter_named
from mipbake.quality.environment import Lighting
from mipbake.quality.figures import Candidate, Figure
from mipbake.quality.metrics import LightViewPairs, flicker_ratio, flicker_snr_db
from mipbake.quality.metrics.pairs import cosine_directions
from mipbake.quality.reference.estimate import bilinear, reference
from mipbake.quality.reference.sequences import SEQUENCE
from mipbake.quality.round_lookups import candidate
from mipbake.quality.samplers import RenderSampler, level_of_detail, look_up, over_frames

Array = NDArray[np.float64]

SLICE_PASSES = 384
"""Samples for each pixel in the reference of a temporal slice, both halves together."""

_ABOVE = np.array([0, 0, 1], np.float32)  # the view
_SIDE, _LIGHTS, _SAMPLES = 24, 256, 64  # effort on the search for the worst pixel
_RIM = 0.999  # radius of the disc of directions, off the horizon by a little

DEGREES = 0.1
"""The turn from frame to frame."""

# Rows see the plane at these angles below its horizon. Footprints grow by 1 / sin^2, twofold from bottom to top.
_TOP = 35.0
_BOTTOM = math.degrees(math.asin(math.sqrt(2) * math.sin(math.radians(_TOP))))


def temporal_slice(
    source: FilteredSource,
    candidates: Sequence[Candidate],
    lighting: Lighting,
    settings: RenderSettings = RenderSettings(),  # noqa: B008
    size: tuple[int, int] = (192, 256),
    passes: int = SLICE_PASSES,
    progress: Progress = lambda _share: None,
) -> tuple[Plot, tuple[Figure, ...]]:
    """One column of pixels of each frame of a slow rotation, side by side: time runs to the right.

    A plane turns by 0.1 degrees a frame around its normal, at levels of detail from 0 (the bottom row) to 1 (the top
    row); only the column is rendered (`Turning`). What is steady in motion draws smooth streaks; what shimmers breaks
    them up.

    Args:
        candidates: of any model, with different names.
        lighting: taken at the exposure of views.
        settings: the seed, and how stacks are looked up.
        size: height of the picture in pixels, and its width, which is the number of frames.
        passes: samples a pixel of the reference, an even number from 4 on.

    Returns:
        The plot, and flicker over its frames: view `rotation`, scale `1:1`.
    """
    height, frames = size
    scene = Turning(exposed(lighting), source.stored.shape[:2], frames, height)
    images = {
        each.name: scene.candidate(
            each.levels, each.method.model, source.wrap, settings.sampler, np.random.default_rng(settings.seed)
        )
        for each in candidates
    }
    first, second = scene.reference(source, passes, np.random.default_rng(settings.seed), progress)
    halves = first.swapaxes(0, 1), second.swapaxes(0, 1)
    figures = tuple(
        Figure(name, measure, "rotation", "1:1", 0.5, function(image.swapaxes(0, 1), *halves))
        for name, image in images.items()
        for measure, function in (("flicker", flicker_ratio), ("flicker-snr", flicker_snr_db))
    )
    caption = (
        f"The same column of pixels of {frames} frames, side by side, while a plane turns by 0.1 degrees a frame. "
        "Level of detail 0 is at the bottom, and 1 is at the top. Smooth streaks are steady in motion; grain and "
        f"breaks in them shimmer. The reference has {passes} samples per pixel."
    )
    reference = np.asarray((first + second) / 2, np.float32)
    return Plot("temporal-slice", "Temporal slice of a slow rotation", caption, reference, images), figures


class Turning:
    """A plane, y = 0, that turns around +y through the world's origin, which is the middle of the picture.

    The picture is twice as wide as high; the column lies at seven eighths of its width, where the plane moves by about
    a quarter of a pixel a frame along the column when `height` is 192. In frame 0 u grows along +x, v along +z, and
    texels are square and so large that the level of detail is 0 at the bottom of the column and about 1 at its top.

    Args:
        lighting: stays where it is.
        size: (height, width) of the texture.
        frames: how many, DEGREES of a turn apart.
        height: of the column, in pixels.
    """

    def __init__(self, lighting: Lighting, size: tuple[int, int], frames: int, height: int) -> None:
        middle = math.radians(_TOP + _BOTTOM) / 2
        self.resolution = height, 2 * height
        self.column = 2 * height * 7 // 8
        self.camera = Camera((0.0, math.sin(middle), math.cos(middle)), field_of_view=_BOTTOM - _TOP)
        self.angles = np.radians(DEGREES * np.arange(frames))
        """(frames,) radians, from +z towards +x."""
        self._size, self._lighting = size, lighting
        # (frames, 3, 3): rows t, b and n in the world; u grows along t and v along -b.
        c, s, zero = np.cos(self.angles), np.sin(self.angles), np.zeros(frames)
        t, b, n = (c, zero, -s), (-s, zero, -c), (zero, zero + 1, zero)
        self._frames = np.stack([np.stack(each, -1) for each in (t, b, n)], 1)
        self._tangent_frames = np.repeat(self._frames.astype(np.float32), height, axis=0)
        self.texel = 1.0
        bottom = self._see((0.0, 0.0))[1].reshape(frames, height, 4)[0, -1:]
        self.texel = float(2 ** level_of_detail(bottom, size)[0])
        """Side of a texel in the world."""

    def candidate(
        self,
        levels: Sequence[NDArray[np.float32]],
        model: str,
        wrap: Wrap,
        sampler: RenderSampler = DEFAULT_SAMPLER,
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.float32]:
        """(height, frames, 3) linear radiance: what an unchanged engine shows, as
        `mipbake.comparing.meshes.mesh_render.candidate` has it.
        """

        def frame(offset: tuple[float, float]) -> NDArray[np.float32]:
            uv, uv_da, view = self._see(offset)
            return np.asarray(self._lit(look_up(levels, uv, uv_da, wrap, sampler, rng), view, model))

        return np.asarray(over_frames(sampler, frame).swapaxes(0, 1))

    def reference(
        self,
        source: FilteredSource,
        passes: int,
        rng: np.random.Generator,
        progress: Progress = lambda _share: None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Two independent halves, (height, frames, 3) each, of `passes` samples a pixel together.

        As `mipbake.comparing.meshes.mesh_render.reference`: the pixel filter's mean of level 0, interpolated bilinearly
        and shaded at each sample; one sub-pixel offset a pass, which all frames share.
        """
        kernel = filter_named(source.pixel_filter)
        level = np.asarray(source.stored, np.float32)
        halves = []
        for half, shift in enumerate(rng.random((2, 2))):
            total, weights = np.zeros((len(self.angles), self.resolution[0], 3)), 0.0
            for index in range(passes // 2):
                offset, sign = kernel.offsets((shift + index * SEQUENCE) % 1.0)
                uv, _, view = self._see((float(offset[0]), float(offset[1])))
                texels = bilinear(level, uv, source.wrap)
                weight = float(sign.prod())
                total += weight * self._lit(texels, view, source.model)
                weights += weight
                progress((half + 2 * (index + 1) / passes) / 2)
            # As mesh_render divides: a constant stays constant under signed filters too.
            halves.append(np.asarray(total / weights, np.float32).swapaxes(0, 1))
        return halves[0], halves[1]

    def _see(self, offset: tuple[float, float]) -> tuple[Array, Array, NDArray[np.float32]]:
        """uv (P, 2), its derivatives (P, 4) per pixel, and views (P, 3) in the world; P frame by frame.

        The ray through the point (X, Y) of the picture, in pixels, has the direction d = d_0 + X d_X + Y d_Y, and
        meets the plane y = 0 at o - d o_y / d_y.
        """
        height, width = self.resolution
        right, up, back = self.camera.view_matrix()[:3, :3]
        pixel = 2 * math.tan(math.radians(self.camera.field_of_view) / 2) / height
        x = (self.column + 0.5 - width / 2 + offset[0]) * pixel
        y = (height / 2 - np.arange(height) - 0.5 + offset[1]) * pixel
        origin = np.asarray(self.camera.position)
        d = x * right + y[:, None] * up - back
        hit = origin - d * (origin[1] / d[:, 1:2])
        dx, dy = (
            -origin[1] * (along * d[:, 1:2] - d * along[1]) / d[:, 1:2] ** 2 for along in (pixel * right, pixel * up)
        )
        view = -d / np.linalg.norm(d, axis=-1, keepdims=True)
        on_plane = self._frames[:, None, :2] * [[[[1.0], [-1.0]]]]
        scale = 1 / (self.texel * np.array([self._size[1], self._size[0]]))
        uv, du, dv = ((on_plane @ p[None, :, :, None])[..., 0] * scale for p in (hit, dx, dy))
        uv_da = np.stack([du[..., 0], dv[..., 0], du[..., 1], dv[..., 1]], -1)
        views = np.tile(view.astype(np.float32), (len(self.angles), 1))
        return uv.reshape(-1, 2), uv_da.reshape(-1, 4), views

    def _lit(self, texels: NDArray[np.float32], view: NDArray[np.float32], model: str) -> NDArray[np.float32]:
        """(frames, height, 3) radiance of all lights together."""
        lit = shading.shade_lit(
            model, texels, self._tangent_frames, view, self._lighting.direction, self._lighting.radiance
        )
        return lit.reshape(len(self.angles), self.resolution[0], 3)


def apparent_brdf(
    source: FilteredSource,
    candidates: Sequence[Candidate],
    seed: int,
    lod: float = 3.0,
    size: int = 96,
    samples: int = 8192,
    at: tuple[float, float] | None = None,
) -> Plot:
    """The pixel filter's mean of the BRDF over one pixel, beside the BRDF of the texel that each stack has there.

    Each image is the hemisphere of light directions seen from above (orthographic, x to the right along u, y upwards):
    the view is straight down, so the mirror direction is the centre, and the rim is the horizon. Values are
    f = BRDF times cosine, scaled by one factor for all images; what lies off the disc is black.

    Args:
        candidates: of any model, the subject first.
        lod: of the pixel, clamped to the levels of the first candidate.
        size: of the images, in directions a side.
        samples: of the reference, over the pixel.
        at: (u, v) of the pixel; by default the place, on a coarse grid, where the first candidate's lobe differs most
            from the pixel's, by its signal-to-noise ratio.
    """
    lod = min(lod, float(len(candidates[0].levels) - 1))
    u, v = at if at is not None else _worst(source, candidates[0], seed, lod)
    where = np.array([[u, v]])
    y, x = np.meshgrid(1 - (2 * np.arange(size) + 1) / size, (2 * np.arange(size) + 1) / size - 1, indexing="ij")
    on = x * x + y * y < _RIM**2
    light = np.stack([x[on], y[on], np.sqrt(1 - x[on] ** 2 - y[on] ** 2)], -1).astype(np.float32)
    pairs = LightViewPairs(light, np.broadcast_to(_ABOVE, light.shape))

    expected = reference(source, where, lod, pairs, samples, np.random.default_rng(seed))[:, 0]
    factor = brightening(expected)

    def disc(f: NDArray[np.float32]) -> Image:
        image = np.zeros((size, size, 3), np.float32)
        image[on] = f * np.float32(factor)
        return image

    images = {
        each.name: disc(candidate(each.levels, each.method.model, source.wrap, where, lod, pairs)[:, 0])
        for each in candidates
    }
    height, width = source.stored.shape[:2]
    caption = (
        f"Light that one pixel reflects at lod {lod:g} (column {int(u % 1 * width)}, row {int(v % 1 * height)} of "
        "level 0) for every direction of the light, seen from straight above. In the middle the light comes from "
        f"above, at the rim it comes from the horizon. All images show the BRDF times the cosine, times {factor:g}. A "
        "texel of a stack has one lobe, so no stack can show a pixel that needs several lobes."
    )
    return Plot("apparent-brdf", "Apparent BRDF of a pixel", caption, disc(expected), images)


def _worst(source: FilteredSource, subject: Candidate, seed: int, lod: float) -> tuple[float, float]:
    """(u, v) on a grid of _SIDE x _SIDE points where the subject's SNR, seen from straight above, is the lowest."""
    grid = (np.arange(_SIDE) + 0.5) / _SIDE
    uv = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    rng = np.random.default_rng([seed, 1])
    light = cosine_directions(rng, _LIGHTS)
    # Half of them near the mirror direction, where lobes are.
    light[::2, :2] *= 0.4
    light[:, 2] = np.sqrt(1 - np.square(light[:, :2]).sum(-1))
    pairs = LightViewPairs(light.astype(np.float32), np.broadcast_to(_ABOVE, light.shape))
    r = reference(source, uv, lod, pairs, _SAMPLES, rng).astype(np.float64)
    p = candidate(subject.levels, subject.method.model, source.wrap, uv, lod, pairs)
    error, signal = np.square(p - r).sum((0, 2)), np.square(r).sum((0, 2))
    u, v = uv[int(np.argmax(error / np.maximum(signal, 1e-30)))]
    return float(u), float(v)
