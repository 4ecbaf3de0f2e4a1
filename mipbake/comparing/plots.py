"""Three plots of Kemppinen et al. 2023, "Pixel filter aware MIP maps", for any material: temporal slice (figure 4),
change under a half-pixel shift (figure 6) and apparent BRDF (figure 8)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.pictures import Change, RenderSettings
from mipbake.comparing.result import Image, Plot
from mipbake.comparing.scenes import exposed
from mipbake.comparing.turning import Turning
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.environment import Lighting
from mipbake.quality.figures import Candidate, Figure
from mipbake.quality.metrics import LightViewPairs, flicker_ratio, flicker_snr_db
from mipbake.quality.metrics.pairs import cosine_directions
from mipbake.quality.reference.estimate import reference
from mipbake.quality.round_lookups import candidate

SLICE_PASSES = 384
"""Samples for each pixel in the reference of a temporal slice, both halves together."""

_BRIGHT = 0.6  # linear value after x / (1 + x) that bright parts of a plot are scaled to
_ABOVE = np.array([0, 0, 1], np.float32)  # the view
_SIDE, _LIGHTS, _SAMPLES = 24, 256, 64  # effort on the search for the worst pixel
_RIM = 0.999  # radius of the disc of directions, off the horizon by a little


class Slice(NamedTuple):
    """A temporal slice, and flicker over its frames: view `rotation`, scale `1:1`."""

    plot: Plot
    figures: tuple[Figure, ...]


def temporal_slice(
    source: FilteredSource,
    candidates: Sequence[Candidate],
    lighting: Lighting,
    settings: RenderSettings = RenderSettings(),  # noqa: B008
    size: tuple[int, int] = (192, 256),
    passes: int = SLICE_PASSES,
    progress: Callable[[float], None] = lambda _share: None,
) -> Slice:
    """One column of pixels of each frame of a slow rotation, side by side: time runs to the right.

    A plane turns by 0.1 degrees a frame around its normal, at levels of detail from 0 (the bottom row) to 1 (the top
    row); only the column is rendered (`Turning`). What is steady in motion draws smooth streaks; what shimmers breaks
    them up.

    Args:
        source: what the reference filters.
        candidates: of any model, with different names.
        lighting: taken at the exposure of views.
        settings: the seed, and how stacks are looked up.
        size: height of the picture in pixels, and its width, which is the number of frames.
        passes: samples a pixel of the reference, an even number from 4 on.
        progress: told the finished share.
    """
    height, frames = size
    scene = Turning(exposed(lighting), source.stored.shape[:2], frames, height)
    images = {
        each.method.name: scene.candidate(
            each.levels, each.method.model, source.wrap, settings.sampler, np.random.default_rng(settings.seed)
        )
        for each in candidates
    }
    first, second = scene.reference(source, passes, np.random.default_rng(settings.seed), progress)
    by_frame = {name: image.swapaxes(0, 1) for name, image in images.items()}
    halves = first.swapaxes(0, 1), second.swapaxes(0, 1)
    figures = tuple(
        Figure(name, measure, "rotation", "1:1", 0.5, function(p, *halves), math.nan, math.nan)
        for name, p in by_frame.items()
        for measure, function in (("flicker", flicker_ratio), ("flicker-snr", flicker_snr_db))
    )
    caption = (
        f"The same column of pixels of {frames} frames, side by side, while a plane turns by 0.1 degrees a frame. "
        "Level of detail 0 is at the bottom, and 1 is at the top. Smooth streaks are steady in motion; grain and "
        f"breaks in them shimmer. The reference has {passes} samples per pixel."
    )
    reference = np.asarray((first + second) / 2, np.float32)
    return Slice(Plot("temporal-slice", "Temporal slice of a slow rotation", caption, reference, images), figures)


def half_pixel_shift(change: Change) -> Plot:
    """How much every pixel changes when the picture moves by half a pixel: the absolute change, black where there is
    none, amplified for all images by one factor that the caption tells. A pixel off the interior is black.
    """
    inside = change.interior[..., None]
    factor = _factor(np.abs(change.reference)[change.interior])
    caption = (
        f"Absolute change of linear radiance when the picture moves by half a pixel, times {factor:g} in all images; "
        "black is no change. Where an image is brighter than the reference, it shimmers; where it is darker, it is "
        f"blurred. {change.scene.title}."
    )

    def shown(signed: Image) -> Image:
        return np.asarray(np.where(inside, np.abs(signed) * factor, 0), np.float32)

    images = {name: shown(image) for name, image in change.images.items()}
    return Plot("half-pixel-shift", "Change under a shift by half a pixel", caption, shown(change.reference), images)


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
        source: what the reference filters.
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
    factor = _factor(expected)

    def disc(f: NDArray[np.float32]) -> Image:
        image = np.zeros((size, size, 3), np.float32)
        image[on] = f * np.float32(factor)
        return image

    def shown(each: Candidate) -> NDArray[np.float32]:
        return candidate(each.levels, each.method.model, source.wrap, where, lod, pairs)[:, 0]

    images = {each.method.name: disc(shown(each)) for each in candidates}
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


def _factor(values: NDArray[np.floating]) -> float:
    """The factor, to two digits, that scales bright values (the 99.5th percentile of their brightest channel) to
    _BRIGHT."""
    bright = float(np.percentile(values.max(-1), 99.5)) if values.size else 0.0
    if bright <= 0:
        return 1.0
    return float(f"{_BRIGHT / (1 - _BRIGHT) / bright:.2g}")
