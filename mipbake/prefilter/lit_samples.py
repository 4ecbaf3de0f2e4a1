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
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.prefilter.held_out import Problem
from mipbake.prefilter.pixel_samples import chunks, levels_seen, share_of
from mipbake.prefilter.scores import EXPOSURE, displayed, lit_reference, placed
from mipbake.render.environment import Lighting, studio
from mipbake.shading.ops import shade

_LIGHTS = 16  # of the room: it is turned at random for every pixel, so few stand for all
_RADIANCES = 1 << 17  # at a time


@dataclass(frozen=True)
class LitBatch:
    """P pixels that look up the same two levels.

    Args:
        level, lower, share, uv: as pixel_samples.Batch has them.
        light: (L, P, 3), view: (P, 3) in the tangent space of each pixel. power: (L, 1, 3) irradiance.
        target: (P, 3) tonemapped, sRGB-encoded reference.
    """

    level: int
    lower: int
    share: Tensor | None
    uv: NDArray[np.float64]
    light: Tensor
    view: Tensor
    power: Tensor
    target: Tensor

    @property
    def seen(self) -> list[tuple[int, Tensor | None]]:
        """The levels that are looked up, and (P,) the share of each; None for all of it."""
        return levels_seen(self.lower, self.share)

    def shown(self, texels: Tensor, model: str) -> Tensor:
        """(P, 3) what (P, C) texels look like."""
        view = self.view[None, None].expand(1, len(self.light), -1, -1)
        radiance = (shade(model, texels, self.light[None], view)[0] * self.power).sum(0)
        return encoded(radiance)


def encoded(radiance: Tensor) -> Tensor:
    """Linear radiance as a display shows it: x / (1 + x), sRGB-encoded, as mipbake.metrics.tonemapped has it."""
    x = radiance.clamp(min=0)
    x = x / (1 + x)
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp(min=1e-6) ** (1 / 2.4) - 0.055)


@lru_cache(maxsize=1)
def _room() -> Lighting:
    return studio(_LIGHTS)


def lit_pixels(
    problem: Problem, level: int, uv: NDArray[np.float64], samples: int, rng: np.random.Generator
) -> Iterator[LitBatch]:
    """Batches of pixels (P, 2) of a level, with `samples` of the reference each."""
    room = _room()
    power = EXPOSURE * room.radiance
    for place, lods, lower in chunks(problem, level, len(uv), max(_LIGHTS, samples), rng):
        centres = uv[place]
        frame, view = placed(rng, len(place))
        target = np.empty((len(place), 3), np.float32)
        step = max(1, _RADIANCES // (samples * _LIGHTS))
        for start in range(0, len(place), step):
            some = slice(start, start + step)
            seen = frame[some], view[some]
            target[some] = displayed(lit_reference(problem, room, centres[some], lods[some, None], *seen, samples, rng))
        turn = torch.from_numpy(frame)
        light = torch.einsum("nij,kj->kni", turn, torch.from_numpy(room.direction.astype(np.float32)))
        yield LitBatch(
            level,
            lower,
            share_of(lods, lower),
            centres,
            light.contiguous(),
            torch.einsum("nij,nj->ni", turn, torch.from_numpy(view)),
            torch.from_numpy(power.astype(np.float32))[:, None],
            torch.from_numpy(target),
        )
