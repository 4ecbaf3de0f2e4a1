"""What people see of patches, as a part of a loss: small pictures under many lights, and their visible error.

A decibel under single lights says little of what is seen. So a network is also trained on pictures (render/
small_pictures.py), looked up as the sampler of the step does it, shaded once a pixel, displayed, and compared with the
reference by its visible error (metrics/visible.py):

- The reference is estimated twice, independently (Lehtinen et al. 2018). The gradient comes from the difference to one
  estimate, and what divides it from the product of both differences, in which their noise has no part in the mean.
- The error of each picture is divided by the mean of what it is now and of what plain averages have in the same
  picture. So pictures of all materials count alike, and pictures that are right nearly nothing.
- Where the network is not ahead of plain averages, its error counts more: what nobody would see as a loss in the mean
  is one to whoever has that material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.material import regularise
from mipbake.metrics.images import displayed
from mipbake.metrics.visible import COSINES, OPPONENT, SENSITIVITY, SIDE, WEIGHT, bands, masked
from mipbake.pixel_filter import resample
from mipbake.reference.source import FilteredSource
from mipbake.render.environment import ENVIRONMENTS, Lighting
from mipbake.render.small_pictures import SLANTS, draw_small_pictures, exposures
from mipbake.sampling import texture
from mipbake.shading.ops import shade
from mipbake.training.base import TORUS

_ROOMS = "studio", "sky", "lamps", "key"
_LIGHTS = 8  # of a room that is a map; a guess
_SAMPLES = 16, 2.0  # of a pixel of level 0 in each estimate, and how many times as many a level more; a guess
_MOST_SAMPLES = 64  # a guess
_PLAIN = 0.5  # share of the error of plain averages in what divides an error; a guess
_FLOOR = 2e-3  # visible error that is as good as none; a guess
_NOISE = 0.5  # share of the noise of an estimate in what divides an error: noisy pictures say less; a guess
_BEHIND, _AHEAD = 3.0, 0.94  # what errors count more that are not below this share of plain averages' error; guesses


@dataclass(frozen=True)
class SeenPictures:
    """Pictures of B patches at one band of levels of detail, one of each patch.

    Args:
        uv: (B, T SIDE^2, 2) of T lookups of each pixel. lod: (B, T SIDE^2). share: (B, 1, T, 1) of each lookup.
        light, view: (B, L, 3). power: (B, L, 1, 3) irradiance times the exposure.
        first, second: (B, 3, SIDE, SIDE) bands of two estimates of what is right. counts: what squared errors count.
        plain: (B,) visible errors of plain averages.
    """

    uv: Tensor
    lod: Tensor
    share: Tensor
    light: Tensor
    view: Tensor
    power: Tensor
    first: Tensor
    second: Tensor
    counts: Tensor
    plain: Tensor

    def value(self, levels: Sequence[Tensor], model: str) -> Tensor:
        """The loss of the stacks of the patches, about 1 where they are as good as plain averages."""
        shown = self._bands(levels, model)
        difference, other = shown - self.first, (shown - self.second).detach()
        with torch.no_grad():
            own = _means(difference * other * self.counts).clamp(min=0)
            noise = _means((self.first - self.second).square() * self.counts) / 2
            scale = (1 - _PLAIN) * own + _PLAIN * self.plain + _NOISE * noise + _FLOOR
            weight = (1 + _BEHIND * (own > _AHEAD * self.plain)) / scale
        return (_means(difference.square() * self.counts) * weight).mean()

    def errors(self, levels: Sequence[Tensor], model: str) -> Tensor:
        """(B,) visible errors, without the noise of the reference in the mean."""
        shown = self._bands(levels, model)
        return _means((shown - self.first) * (shown - self.second) * self.counts)

    def _bands(self, levels: Sequence[Tensor], model: str) -> Tensor:
        batch, taps = len(self.uv), self.share.shape[2]
        found = texture(levels[0], self.uv[:, None], None, self.lod[:, None], list(levels[1:]), boundary_mode=TORUS)
        texels = (found.reshape(batch, SIDE * SIDE, taps, -1) * self.share).sum(2)
        radiance = (shade(model, texels, self.light, self.view) * self.power).sum(1)
        return _bands(_displayed(radiance).reshape(batch, SIDE, SIDE, 3))


def draw_pictures(
    sources: Sequence[FilteredSource],
    lod: NDArray[np.floating],
    sampler: str,
    rng: np.random.Generator,
) -> SeenPictures:
    """A picture of each of B patches, at (B,) levels of detail; kinds of slants take turns."""
    rooms = [_room(_ROOMS[int(rng.integers(len(_ROOMS)))]) for _ in sources]
    most = max(len(room.direction) for room in rooms)
    turn = int(rng.integers(len(SLANTS)))
    slants = np.array([rng.uniform(*SLANTS[(turn + index) % len(SLANTS)]) for index in range(len(sources))])
    size, taps = sources[0].stored.shape[:2], 1
    drawn, shown, power = [], [], np.zeros((len(sources), most, 1, 3), np.float32)
    lights = np.zeros((len(sources), 2, most, 3), np.float32)
    lights[..., 2] = 1
    for index, (source, room) in enumerate(zip(sources, rooms, strict=True)):
        one = slice(index, index + 1)
        picture = draw_small_pictures(
            rng, np.maximum(lod[one], 0), slants[one], (size[1], size[0]), sampler, room, rng.random((1, 2))
        )
        samples = min(int(_SAMPLES[0] * _SAMPLES[1] ** max(0.0, float(lod[index]))), _MOST_SAMPLES)
        estimates = [picture.reference(source, samples, rng) for _ in range(2)]
        exposure = exposures((estimates[0] + estimates[1]) / np.float32(2))
        count = len(room.direction)
        lights[index, 0, :count], lights[index, 1, :count] = picture.light[0], picture.view[0]
        power[index, :count, 0] = picture.power * exposure[0]
        shown.append([displayed(each * exposure).astype(np.float32) for each in estimates])
        drawn.append(picture)
        taps = max(taps, int(picture.lookups[0]))
    uv = np.zeros((len(sources), SIDE * SIDE, taps, 2), np.float32)
    share = np.zeros((len(sources), 1, taps, 1), np.float32)
    for index, picture in enumerate(drawn):
        count = int(picture.lookups[0])
        uv[index, :, :count] = picture.looked_up_at(slice(0, 1), count)[0]
        share[index, 0, :count] = 1 / count
    first, second = (np.concatenate([each[half] for each in shown]).reshape(-1, SIDE, SIDE, 3) for half in (0, 1))
    found = SeenPictures(
        torch.from_numpy(uv.reshape(len(sources), -1, 2)),
        torch.from_numpy(np.repeat(np.maximum(lod, 0).astype(np.float32)[:, None], SIDE * SIDE * taps, 1)),
        torch.from_numpy(share),
        torch.from_numpy(np.ascontiguousarray(lights[:, 0])),
        torch.from_numpy(np.ascontiguousarray(lights[:, 1])),
        torch.from_numpy(power),
        torch.from_numpy(bands(first)),
        torch.from_numpy(bands(second)),
        torch.from_numpy(masked(bands((first + second) / 2))),
        torch.zeros(len(sources)),
    )
    model = sources[0].model
    plain = [torch.from_numpy(each) for each in plain_levels(np.stack([s.stored for s in sources]), model)]
    return replace(found, plain=found.errors(plain, model).clamp(min=0))


def plain_levels(patches: NDArray[np.float32], model: str) -> list[NDArray[np.float32]]:
    """(B, S_L, S_L, C) of every level of (B, S, S, C) patches: what GPUs average."""
    levels, size = [patches], patches.shape[1]
    while size > 1:
        size //= 2
        levels.append(np.stack([resample(each, (size, size), "box", TORUS) for each in levels[-1]]))
    return [levels[0], *(regularise(each, model) for each in levels[1:])]


@lru_cache(maxsize=len(_ROOMS))
def _room(name: str) -> Lighting:
    return ENVIRONMENTS[name](_LIGHTS)


def _means(squares: Tensor) -> Tensor:
    """`metrics.visible.mean_squares` of each picture."""
    return squares.sum((1, 2, 3)) / WEIGHT


def _displayed(radiance: Tensor) -> Tensor:
    """`metrics.images.displayed` with a gradient."""
    x = radiance / (1 + radiance)
    curve = 1.055 * x.clamp(min=0.0031308).pow(1 / 2.4) - 0.055
    return torch.where(x <= 0.0031308, 12.92 * x, curve)


def _bands(pictures: Tensor) -> Tensor:
    """`metrics.visible.bands` with a gradient."""
    opponent = torch.einsum("ck,nyxk->ncyx", torch.from_numpy(OPPONENT), pictures)
    basis = torch.from_numpy(COSINES)
    return torch.from_numpy(SENSITIVITY) * (basis @ opponent @ basis.T)
