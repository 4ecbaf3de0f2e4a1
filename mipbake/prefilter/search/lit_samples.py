"""Pixels under a studio's lights, tonemapped: what texels are fitted to beside single lights.

Single lights say most of the brightest pairs. A stack that follows them alone trades the colour and the brightness of
all that is dim, which is most of what is seen in a room, for its highlights. Here a pixel is turned to the room at
random and shows the sum over all lights, as a display shows it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from mipbake.judging.lit_renders import EXPOSURE, displayed_float32, lit_reference, placed, room
from mipbake.prefilter.search.pixel_samples import chunked, levels_seen, samples_at, share_of
from mipbake.reference.problem import Image, Problem
from mipbake.render.environment import Lighting, studio
from mipbake.shading import shade
from mipbake.shading.adjoint import shade_adjoint

_LIGHTS = 16  # lights of the room: it is turned at random for every pixel, so few stand for all; a guess


@dataclass(frozen=True)
class LitPixels:
    """P pixels under all lights of a room.

    Args:
        light: (L, P, 3), view: (P, 3) in the tangent space of each pixel. power: (L, 3) irradiance.
    """

    light: Image
    view: Image
    power: Image

    @classmethod
    def of(cls, lighting: Lighting, frame: Image, view: Image) -> LitPixels:
        """Pixels with (P, 3, 3) frames and (P, 3) views in a room at EXPOSURE."""
        light = np.einsum("nij,kj->kni", frame, lighting.direction.astype(np.float32), optimize=True)
        power = (EXPOSURE * lighting.radiance).astype(np.float32)
        return cls(np.ascontiguousarray(light), np.einsum("nij,nj->ni", frame, view), power)

    def radiance(self, texels: Image, model: str) -> Image:
        """(P, 3) what (P, C) texels send to the viewer."""
        seen = shade(model, texels[None], self.light[None], self._views)[0]
        return np.asarray(np.einsum("lpc,lc->pc", seen, self.power))

    def adjoint(self, texels: Image, model: str, gradient: Image) -> Image:
        """(P, C) gradients by texels, from (P, 3) ones by `radiance`."""
        by_light = (self.power[:, None] * gradient)[None]
        return np.asarray(shade_adjoint(model, texels[None], self.light[None], self._views, by_light)[0])

    @property
    def _views(self) -> Image:
        return np.broadcast_to(self.view, (1, *self.light.shape))


@dataclass(frozen=True)
class LitChunk:
    """P pixels that look up the same two levels.

    Args:
        level, lower, share, uv: as pixel_samples.Chunk has them.
        pixels: what they see. estimate: (P, 3) of the reference, tonemapped and sRGB-encoded.
    """

    level: int
    lower: int
    share: Tensor | None
    uv: NDArray[np.float64]
    pixels: LitPixels
    estimate: Image

    @property
    def seen(self) -> list[tuple[int, Tensor | None]]:
        """The levels that are looked up, and (P,) the share of each; None for all of it."""
        return levels_seen(self.lower, self.share)


@lru_cache(maxsize=1)
def _lighting() -> Lighting:
    return studio(_LIGHTS)


def lit_pixels(
    problem: Problem, level: int, uv: NDArray[np.float64], samples: int, rng: np.random.Generator
) -> Iterator[LitChunk]:
    """Chunks of pixels (P, 2) of a level; a pixel of level 0 has `samples` of the reference, others as samples_at
    says."""
    lighting, samples = _lighting(), samples_at(level, samples)
    for place, lods, lower in chunked(problem, level, len(uv), max(_LIGHTS, samples), rng):
        centres = uv[place]
        frame, view = placed(rng, len(place))
        estimate = displayed_float32(lit_reference(problem, room(lighting, frame, view), centres, lods, samples, rng))
        yield LitChunk(level, lower, share_of(lods, lower), centres, LitPixels.of(lighting, frame, view), estimate)
