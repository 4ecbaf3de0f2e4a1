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
from mipbake.material.aim import Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import resample
from mipbake.quality.environment import ENVIRONMENTS, Lighting
from mipbake.quality.metrics.images import tonemapped
from mipbake.quality.metrics.visible import COSINES, OPPONENT, SENSITIVITY, SIDE, WEIGHT, adaptation, bands
from mipbake.quality.small_pictures import MEDIAN, SLANTS, draw_small_pictures
from mipbake.sampling import texture
from mipbake.shading import shade
from mipbake.training.base import TORUS

_ROOMS = "studio", "sky", "lamps", "key"
_LIGHTS = 32  # of a room that is a map
_SAMPLES = 8, 1.5  # of a pixel of level 0 in each estimate, and how many times as many a level more
_MOST_SAMPLES = 64
_PLAIN = 0.5  # share of the error of plain averages in what divides an error
_FLOOR = 1e-3  # mean square that is as good as none
_NOISE = 0.5  # share of the noise of an estimate in what divides an error: noisy pictures say less
_CONTRAST = 100.0  # between the mean of a picture and the darkest median that it is exposed for
_DARK = 1e-6  # radiance below which a picture is black
_BEHIND, _AHEAD = 3.0, 0.94  # what errors count more that are not below this share of plain averages' error


@dataclass(frozen=True)
class SeenPictures:
    """Pictures of B patches at one band of levels of detail, one of each patch.

    Args:
        uv: (B, T F SIDE^2, 2) of T lookups of each pixel in each of F frames. lod: (B, T F SIDE^2).
        share: (B, 1, T, 1) of each lookup in its frame.
        light, view: (B, L, 3). power: (B, L, 1, 3) irradiance times the exposure.
        adapted: (B, 1, 1, 1) light that eyes are adapted to.
        first, second: (B, 3, SIDE, SIDE) bands of two estimates of what is right.
        plain: (B,) visible errors of plain averages. frames: F.
    """

    uv: Tensor
    lod: Tensor
    share: Tensor
    light: Tensor
    view: Tensor
    power: Tensor
    adapted: Tensor
    first: Tensor
    second: Tensor
    plain: Tensor
    frames: int

    def value(self, levels: Sequence[Tensor], model: str) -> Tensor:
        """The loss of the stacks of the patches, about 1 where they are as good as plain averages."""
        shown = self._bands(levels, model)
        difference, other = shown - self.first, (shown - self.second).detach()
        with torch.no_grad():
            own = _means(difference * other).clamp(min=0)
            noise = _means((self.first - self.second).square()) / 2
            scale = (1 - _PLAIN) * own + _PLAIN * self.plain + _NOISE * noise + _FLOOR
            weight = (1 + _BEHIND * (own > _AHEAD * self.plain)) / scale
        return (_means(difference.square()) * weight).mean()

    def errors(self, levels: Sequence[Tensor], model: str) -> Tensor:
        """(B,) visible errors, without the noise of the reference in the mean."""
        shown = self._bands(levels, model)
        return _means((shown - self.first) * (shown - self.second))

    def _bands(self, levels: Sequence[Tensor], model: str) -> Tensor:
        batch, taps = len(self.uv), self.share.shape[2]
        found = texture(levels[0], self.uv[:, None], None, self.lod[:, None], list(levels[1:]), boundary_mode=TORUS)
        texels = (found.reshape(batch, SIDE * SIDE * self.frames, taps, -1) * self.share).sum(2)
        radiance = (shade(model, texels, self.light, self.view) * self.power).sum(1)
        if self.frames > 1:
            radiance = radiance.reshape(batch, SIDE * SIDE, self.frames, 3).mean(2)
        light = (radiance / (1 + radiance)).reshape(batch, SIDE, SIDE, 3)
        return _bands(light / self.adapted)


def draw_pictures(
    sources: Sequence[FilteredSource],
    lod: NDArray[np.floating],
    sampler: Sampler,
    rng: np.random.Generator,
) -> SeenPictures:
    """A picture of each of B patches, at (B,) levels of detail of lookups; kinds of slants take turns, and so do rooms.

    Lookups below level 0 are at level 0, of pixels that are no smaller than its texels.
    """
    count, size, turn = len(sources), sources[0].stored.shape[:2], int(rng.integers(len(SLANTS)))
    slants = np.array([rng.uniform(*SLANTS[(turn + index) % len(SLANTS)]) for index in range(count)])
    rooms = [_room(_ROOMS[index]) for index in rng.permutation(len(_ROOMS))]
    finest = np.maximum(lod, min(sampler.bias, 0))
    pictures = draw_small_pictures(rng, finest, slants, (size[1], size[0]), sampler, rooms, rng.random((count, 2)))
    estimates = [np.empty((count, SIDE * SIDE, 3), np.float32) for _ in range(2)]
    for index, source in enumerate(sources):
        samples = min(int(_SAMPLES[0] * _SAMPLES[1] ** max(0.0, float(lod[index] - sampler.bias))), _MOST_SAMPLES)
        for each in estimates:
            each[index] = pictures.part(np.array([index])).reference(source, samples, rng)[0]
    exposure = _exposures((estimates[0] + estimates[1]) / np.float32(2))
    first, second = (tonemapped(each * exposure).reshape(-1, SIDE, SIDE, 3) for each in estimates)
    adapted = adaptation((first + second) / np.float32(2))
    taps = int(pictures.lookups.max())
    uv = np.zeros((count, pictures.points, taps, 2), np.float32)
    share = np.zeros((count, 1, taps, 1), np.float32)
    for index, own in enumerate(pictures.lookups.tolist()):
        uv[index, :, :own] = pictures.looked_up_at(slice(index, index + 1), own)[0]
        share[index, 0, :own] = 1 / own
    found = SeenPictures(
        torch.from_numpy(uv.reshape(count, -1, 2)),
        torch.from_numpy(np.repeat(np.maximum(finest, 0).astype(np.float32)[:, None], pictures.points * taps, 1)),
        torch.from_numpy(share),
        torch.from_numpy(pictures.light),
        torch.from_numpy(pictures.view),
        torch.from_numpy((pictures.power * exposure)[:, :, None]),
        torch.from_numpy(adapted),
        torch.from_numpy(bands(first / adapted)),
        torch.from_numpy(bands(second / adapted)),
        torch.zeros(count),
        pictures.frames,
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


def _exposures(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 1, 1) exposures of pictures of which (N, P, 3) is right, each for its own median: what is dim in one material
    is all there is to see of another one, as under lamps that a dark mirror does not show."""
    flat = radiance.reshape(len(radiance), -1)
    own = np.maximum(np.median(flat, -1), flat.mean(-1) / _CONTRAST)
    return np.asarray((MEDIAN / np.maximum(own, _DARK))[:, None, None], np.float32)


@lru_cache(maxsize=len(_ROOMS))
def _room(name: str) -> Lighting:
    return ENVIRONMENTS[name](_LIGHTS)


def _means(squares: Tensor) -> Tensor:
    """`metrics.visible.mean_squares` of each picture."""
    return squares.sum((1, 2, 3)) / WEIGHT


@lru_cache(maxsize=4)
def _constants(device: torch.device) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(each).to(device) for each in (OPPONENT, COSINES, SENSITIVITY))


def _bands(contrasts: Tensor) -> Tensor:
    """`metrics.visible.bands` with a gradient."""
    matrix, basis, sensitivity = _constants(contrasts.device)
    opponent = torch.einsum("ck,nyxk->ncyx", matrix, contrasts)
    return sensitivity * (basis @ opponent @ basis.T)
