"""Small pictures, as people see them: what texels are fitted to beside single lights.

Single lights say most of the brightest pairs. A stack that follows them alone trades the colour and the brightness of
all that is dim, which is most of what is seen in a room, for its highlights. Here surfaces are turned to a room at
random and show the sum over all lights, as a display shows it and eyes see it (mipbake.quality.judging.shown).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.search.gauss_newton import signs
from mipbake.baking.search.pixel_samples import levels_seen, samples_at, share_of
from mipbake.quality.judging.shown import KINDS_SHOWN, Shown, draw_shown
from mipbake.quality.metrics.visible import OPPONENT, SENSITIVITY, WEIGHT, bands_adjoint
from mipbake.quality.reference.problem import Image, Problem, Region
from mipbake.quality.small_pictures import PIXELS, reach


@dataclass(frozen=True, eq=False)
class PictureChunk:
    """N pictures that look up the same two levels, the same number of times for each pixel.

    Args:
        level: that the pictures belong to: their levels of detail are within 1/2 of it.
        lower: the finer of the two levels that they look up.
        share: (P,) of the coarser one in each lookup; None where all are 0.
        uv: (P, 2) of all lookups, the ones of a pixel side by side, frame by frame.
        lookups: of each pixel in a frame.
        some: (N,) which of the pictures that were drawn these are. shown: all of these. kinds: (N,) of these.
    """

    level: int
    lower: int
    share: NDArray[np.float32] | None
    uv: NDArray[np.float64]
    lookups: int
    some: NDArray[np.intp]
    shown: Shown
    kinds: NDArray[np.int64]

    @property
    def seen(self) -> list[tuple[int, NDArray[np.float32] | None]]:
        """The levels that are looked up, and (P,) the share of each; None for all of it."""
        return levels_seen(self.lower, self.share)

    @property
    def parts(self) -> int:
        """How many lookups there are of a pixel, in all frames; each has the same share in it."""
        return self.lookups * self.own.pictures.frames

    @cached_property
    def own(self) -> Shown:
        """These pictures alone."""
        return self.shown.part(self.some)

    def pixels(self, texels: Image) -> Image:
        """(N, points, C) what pixels see in every frame, of (P, C) lookups."""
        points = self.own.pictures.points
        return np.asarray(texels.reshape(len(self.some), points, self.lookups, -1).mean(2))

    def adjoint(self, model: str, texels: Image, gradient: Image) -> Image:
        """(P, C) derivatives by (P, C) lookups, from (N, PIXELS, 3) derivatives by the radiance of pixels."""
        by_pixel = self.own.pictures.adjoint(model, self.pixels(texels), gradient / np.float32(self.lookups))
        return np.repeat(by_pixel.reshape(-1, by_pixel.shape[-1]), self.lookups, 0)


@dataclass(frozen=True)
class PictureSlopes:
    """What pictures say of the errors of their pixels, of half of what is minimised.

    Args:
        by_radiance: (N, PIXELS, 3) slopes. shown: (N, PIXELS, 3) derivatives of contrasts by the radiance.
        bounds: (N, 3) of the curvature, for squares of each opponent colour of contrasts.
    """

    by_radiance: Image
    shown: Image
    bounds: Image

    def combinations(self, rng: np.random.Generator) -> Image:
        """(N, PIXELS, 3) random combinations of the opponent colours of each pixel, by its radiance: the mean of their
        squares bounds the curvature."""
        turned = signs(self.shown.shape, rng) * np.sqrt(self.bounds)[:, None]
        return np.asarray(turned @ OPPONENT * self.shown)


def picture_chunks(
    problem: Problem, region: Region, level: int, count: int, samples: int, rng: np.random.Generator
) -> Iterator[PictureChunk]:
    """Chunks of pictures of a level, half of them slanted; a pixel of level 0 has `samples` of the reference."""
    for half in (-0.5, 0.0):
        lod = min(max(level + half + 0.5 * rng.random(), 0.0), float(problem.last))
        shown = draw_shown(problem, region, lod, count // 2, samples_at(level, samples), rng)
        lower = int(lod) if lod < problem.last else level
        kinds = np.repeat(np.arange(KINDS_SHOWN), len(shown.exposure) // KINDS_SHOWN)
        for lookups in np.unique(shown.pictures.lookups).tolist():
            some = np.flatnonzero(shown.pictures.lookups == lookups)
            uv = shown.pictures.looked_up_at(some, lookups).reshape(-1, 2)
            share = share_of(np.full(len(uv), lod), lower)
            yield PictureChunk(level, lower, share, uv, lookups, some, shown, kinds[some])


def texels_around(problem: Problem, region: Region, level: int) -> int:
    """How many texels of a level around a region the pictures of the region look up."""
    finest = min(region.levels.stop - 0.5, level + 1.0)  # no finer level of detail than that looks the level up
    return math.ceil(reach(problem.sampler) * 2 ** (finest - level)) + 1


def picture_slopes(
    chunks: Sequence[PictureChunk], texels: Sequence[Image], model: str, counts: Mapping[int, NDArray[np.float64]]
) -> list[PictureSlopes]:
    """What each chunk says, of (P, C) lookups.

    Args:
        counts: by level, (V,) what the visible error of each kind of pictures counts.
    """
    many = {level: np.zeros(KINDS_SHOWN) for level in counts}
    for chunk in chunks:
        many[chunk.level] += np.bincount(chunk.kinds, minlength=KINDS_SHOWN)
    out = []
    for chunk, seen in zip(chunks, texels, strict=True):
        shown = chunk.own
        radiance = shown.pictures.radiance(model, chunk.pixels(seen))
        slope = shown.slope(radiance)
        each = counts[chunk.level] / np.maximum(many[chunk.level], 1) / WEIGHT
        error = shown.error(radiance)
        weight = (each[chunk.kinds] / error.roots[0]).astype(np.float32)
        by_shown = bands_adjoint(weight[:, None, None, None] * error.off).reshape(-1, PIXELS, 3)
        # No change of all pixels together has more curvature than the band of its colour that weighs most.
        most = weight[:, None] * np.square(SENSITIVITY).max((1, 2))
        out.append(PictureSlopes(by_shown * slope, slope, most))
    return out
