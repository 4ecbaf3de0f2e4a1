"""The filtered reference (equation 3 of Kemppinen et al. 2023), estimated: for bakes, judging, measures and training.

    R = integral of p((x', y') / 2^lod) f(theta(x - x', y - y'), l, v) dx' dy'

is the mean radiance at places around a pixel's centre that lie there as the pixel filter p weighs them. At each place
level 0 is looked up bilinearly and shaded. Lights and viewers are constant over a pixel (section 3.2 of the paper).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap
from mipbake.quality.metrics.pairs import LightViewPairs
from mipbake.quality.reference.lighting import Illumination, common_pairs
from mipbake.quality.reference.samples import Generators, Pixels, Samples, Span

Image = NDArray[np.float32]

_LOOKUPS = 1 << 16  # at a time: enough that calls are few
_RADIANCES = 1 << 17  # at a time: 1.5 MiB, which stay in the cache


def estimate(
    source: FilteredSource,
    pixels: Pixels,
    lighting: Illumination,
    samples: int,
    rng: Generators,
    out: Image | None = None,
) -> Image:
    """Unbiased Monte Carlo estimates of the reference: (G, K, P, 3) linear radiance, K renders of P pixels in G groups.

    Weights of a filter with negative lobes are 1 on average only. The pixel's centre takes up what is missing in the
    weights of its samples, as a control variate: the estimate stays unbiased, and is exact on a constant material.

    Args:
        samples: of each pixel, in each group.
        rng: one for all, or one for each group, where groups have pixels of their own. Estimates from different
            generators are independent.
        out: to write to.
    """
    groups, count = lighting.groups, pixels.uv.shape[-2]
    height, width = source.stored.shape[:2]
    drawn = Samples(source.pixel_filter, (width, height), pixels, groups, samples, rng)
    if out is None:
        out = np.empty((groups, lighting.renders, count, 3), np.float32)
    for whole in _spans(Span(slice(0, groups), slice(0, count)), samples, _LOOKUPS):
        uv, weights = drawn.at(whole)
        texels = bilinear(source.stored, uv, source.wrap)
        for span in _spans(whole, samples * lighting.renders, _RADIANCES):
            rows, some = span.inside(whole)
            weight = None if weights is None else weights[rows, :, some]
            mean = _mean(source.model, lighting, texels[rows, :, some], weight, span)
            if weight is not None:
                centres = bilinear(source.stored, drawn.centres(span), source.wrap)
                alone = lighting.shaded(source.model, centres, span).reshape(mean.shape)
                mean += _weighed(alone, 1 - weight.mean(1)[:, None])
            out[span.groups, :, span.pixels] = mean
    return out


def reference(
    source: FilteredSource,
    uv: NDArray[np.floating],
    lod: float,
    pairs: LightViewPairs,
    samples: int,
    rng: np.random.Generator,
) -> Image:
    """(K, P, 3): `estimate` for square pixels (P, 2) of one level of detail that have K pairs in common."""
    return np.asarray(estimate(source, Pixels(uv, lod), common_pairs(pairs), samples, rng)[0])


def bilinear(level: Image, uv: NDArray[np.floating], wrap: Wrap) -> Image:
    """(..., C): an image at (..., 2) uv, bilinearly."""
    texels = sampling.texture(level[None], uv.reshape(1, 1, -1, 2), filter_mode="linear", boundary_mode=wrap)
    return np.asarray(texels.reshape(*uv.shape[:-1], level.shape[-1]))


def _mean(model: str, lighting: Illumination, texels: Image, weights: Image | None, span: Span) -> Image:
    """(R, K, n, 3) mean over the samples of (R, S, n, C) texels, with (R, S, n) weights."""
    rows, samples, count, _ = texels.shape
    step = max(1, _RADIANCES // lighting.renders)
    total: Image | None = None
    for start in range(0, samples, step):
        some = slice(start, start + step)
        radiance = lighting.shaded(model, texels[:, some], span)
        _, outer, here = radiance.shape[:3]
        if weights is not None:
            radiance = _weighed(radiance, weights[:, None, some, None])
        if samples == 1:
            return radiance.reshape(rows, -1, count, 3)
        # A product with equal numbers: several times faster than NumPy's mean along an axis in the middle.
        share = np.full((1, here), 1 / samples, np.float32)
        mean = (share @ radiance.reshape(rows * outer, here, -1)).reshape(rows, -1, count, 3)
        total = mean if total is None else total + mean
    assert total is not None
    return total


def _weighed(radiance: Image, weights: Image) -> Image:
    """(..., n, 3) radiance, multiplied in place by weights that broadcast to (..., n)."""
    # Rows of colours side by side: NumPy multiplies them several times faster.
    rows = radiance.reshape(*radiance.shape[:-2], -1)
    rows *= np.repeat(weights, 3, -1)
    return np.asarray(rows.reshape(radiance.shape))


def _spans(whole: Span, work: int, most: int) -> Iterator[Span]:
    """Parts that are worked on at a time: about `most` pieces of work, where a pixel in a group is so many."""
    groups, pixels = whole
    count = max(1, min(pixels.stop - pixels.start, most // work))
    rows = max(1, most // (work * count)) if count == pixels.stop - pixels.start else 1
    for row in range(groups.start, groups.stop, rows):
        for pixel in range(pixels.start, pixels.stop, count):
            yield Span(slice(row, min(groups.stop, row + rows)), slice(pixel, min(pixels.stop, pixel + count)))
