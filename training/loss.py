"""The rendering loss (section 3.2 of Kemppinen et al. 2023).

A patch is a torus. For each of S levels of detail it is seen by a grid of pixels as fine as its texels, each pixel
somewhere inside its texel (the random sub-pixel jitter). For each light-view pair:

- prediction: the predicted stack looked up once, trilinearly, and shaded once;
- target: level 0 looked up bilinearly at the pixel plus 2^lod times an offset drawn from the pixel filter, shaded;
  or the mean of several such samples. Its expectation is the filtered render (equation 3), and the optimum of the loss
  is just that (Noise2Noise).

The offsets of a pixel are a low-discrepancy sequence, shifted at random for each pixel (Cranley and Patterson 1976).
Each single offset is distributed as the filter, so nothing is biased, and neighbours in the sequence cover it evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from mipbake.metrics.pairs import cosine_directions, near_mirror_lights
from mipbake.prefilter.pixel_filter import filter_named
from mipbake.sampling import texture
from mipbake.shading.ops import shade
from mipbake.training.config import LossConfig

TORUS = ("wrap", "wrap")

EPSILON = 1e-4
"""Of equation 5, per summed value: a render whose mean square radiance lies below counts less and less. So a patch that
is predicted black, its normals beyond the horizon, does not outweigh thousands of others."""

_CEILING = 1e-4  # relative error below which a render counts as right: 40 dB

_TABLE = 1 << 14  # quantiles of the pixel filter
_SEQUENCE = np.array([0.7548776662466927, 0.5698402909980532])  # Roberts 2018: powers of 1 / plastic number


@dataclass(frozen=True)
class Views:
    """What one step looks at: B patches, K pairs, S levels of detail, N pixels each.

    Args:
        light, view: (B, K, 3) unit vectors.
        lod: (B, S * N); each patch's S values repeated over its pixels.
        uv: (B, S * N, 2) pixel positions.
    """

    light: Tensor
    view: Tensor
    lod: Tensor
    uv: Tensor
    lods: int


def draw_views(config: LossConfig, rng: np.random.Generator) -> Views:
    """Random pairs, levels of detail (uniform to half a level beyond both ends, then clamped) and pixel positions."""
    b, s, n = config.crops, config.lods, config.crop_size
    view = cosine_directions(rng, b * config.pairs).reshape(b, config.pairs, 3)
    light = cosine_directions(rng, b * config.pairs).reshape(b, config.pairs, 3)
    mirror = config.mirror_pairs
    if mirror:
        light[:, :mirror] = near_mirror_lights(rng, view[:, :mirror].reshape(-1, 3)).reshape(b, mirror, 3)
    lod = np.clip(rng.uniform(-0.5, config.max_lod + 0.5, (b, s)), 0, config.max_lod)
    row, column = np.divmod(np.arange(n * n, dtype=np.float32), n)
    uv = (np.stack([column, row], -1) + rng.random((b, s, n * n, 2), np.float32)) / n
    return Views(
        torch.from_numpy(light.astype(np.float32)),
        torch.from_numpy(view.astype(np.float32)),
        torch.from_numpy(np.repeat(lod.astype(np.float32), n * n, 1)),
        torch.from_numpy(uv.reshape(b, s * n * n, 2)),
        s,
    )


@lru_cache(maxsize=8)
def _quantiles(pixel_filter: str) -> tuple[Tensor, Tensor]:
    """(table,) offsets in pixels, at the midpoints of equally likely bins of |p|, and their weights."""
    offsets, weights = filter_named(pixel_filter).offsets((np.arange(_TABLE) + 0.5) / _TABLE)
    return torch.from_numpy(offsets.astype(np.float32)), torch.from_numpy(weights.astype(np.float32))


def draw_target(
    patches: Tensor, views: Views, model: str, pixel_filter: str, samples: int, rng: np.random.Generator
) -> Tensor:
    """Unbiased noisy target renders (B, K, S * N, 3) of (B, size, size, C) patches, the mean of `samples` each.

    A pixel is looked up K times in all. `samples` pairs share as many of the lookups, so that more samples a target
    cost shading, which is cheap, and no lookups; with one, every pair has a lookup of its own.
    """
    b, k = views.light.shape[:2]
    groups, points = k // samples, views.uv.shape[1]
    offsets, weights = _quantiles(pixel_filter)
    signed = bool((weights != weights[0]).any())
    reach = torch.exp2(views.lod)[:, None, :, None] / patches.shape[1]
    light, view = (d.reshape(b * groups, samples, 3) for d in (views.light, views.view))
    # Integers in place of fractions: adding two and masking is adding modulo 1, exactly.
    shift = torch.from_numpy(rng.integers(_TABLE, size=(b, 1, points, 2), dtype=np.int32))
    total = torch.zeros(())
    for index in range(samples):
        place = (np.arange(groups)[:, None] * samples + index) * _SEQUENCE % 1 * _TABLE
        quantile = (shift + torch.from_numpy(place.astype(np.int32))[:, None]) & (_TABLE - 1)
        offset = offsets.index_select(0, quantile.flatten()).reshape(quantile.shape)
        where = torch.addcmul(views.uv[:, None], offset, reach)
        texels = texture(patches, where, filter_mode="linear", boundary_mode=TORUS)
        radiance = shade(model, texels.reshape(b * groups, points, -1), light, view)
        if signed:
            weight = weights.index_select(0, quantile.flatten()).reshape(quantile.shape).prod(-1)
            radiance = radiance * weight.reshape(b * groups, 1, points, 1)
        total = total + radiance
    return (total / samples).reshape(b, k, points, 3)


def predict(levels: list[Tensor], views: Views, model: str) -> Tensor:
    """(B, K, S * N, 3) renders of a stack of (B, H_L, W_L, C) levels, looked up and shaded once a pixel."""
    return shade(model, look_up(levels, views), views.light, views.view)


def look_up(levels: list[Tensor], views: Views) -> Tensor:
    """(B, S * N, C) texels of a stack of (B, H_L, W_L, C) levels."""
    uv, lod = views.uv[:, None], views.lod[:, None]
    return texture(levels[0], uv, None, lod, levels[1:], boundary_mode=TORUS).flatten(1, 2)


def squared_errors(prediction: Tensor, target: Tensor, lods: int) -> Tensor:
    """(B, K, S): squared error of each render, summed over pixels and channels, of (B, K, S * N, 3) renders."""
    b, k = prediction.shape[:2]
    return (prediction - target).square().reshape(b, k, lods, -1).sum(-1)


def relative_loss(prediction: Tensor, target: Tensor, lods: int) -> Tensor:
    """Equation 5 for each of the B K S renders, summed over pixels and channels; the mean over all renders.

    Args:
        prediction, target: (B, K, S * N, 3). Gradients flow through the numerator's prediction only.
        lods: S.
    """
    b, k = prediction.shape[:2]
    norm = prediction.detach().reshape(b, k, lods, -1)
    epsilon = EPSILON * norm.shape[-1]
    return (squared_errors(prediction, target, lods) / (norm.square().sum(-1) + epsilon)).mean()


def error_loss(prediction: Tensor, target: Tensor, independent: Tensor, views: Views, mirror: int) -> Tensor:
    """Squared errors over the error that the prediction has now: its gradient is that of the mean error in decibels.

    Equation 5 divides by the energy, so a material that averaging gets nearly right hardly pulls, and a network stays
    imprecise exactly there. Dividing by the error itself makes a decibel count the same everywhere, and bounds the pull
    of a single bad render. The error is the mean over the renders of one patch and level whose pairs were drawn alike.

    Args:
        prediction, target: (B, K, S * N, 3). Gradients flow through the numerator's prediction only.
        independent: a second estimate of the same target, for the denominator. The noise of one and the same would
            weigh down the very samples that it made large, and bias the optimum.
        mirror: how many of the K pairs, the first, were drawn near the mirror direction.
    """
    error = squared_errors(prediction.detach(), independent, views.lods)
    energy = squared_errors(torch.zeros_like(independent), independent, views.lods)
    floor = EPSILON * prediction[0, 0].numel() / views.lods
    norm = error + _CEILING * energy + floor
    groups = [g for g in (norm[:, :mirror], norm[:, mirror:]) if g.shape[1]]
    norm = torch.cat([g.mean(1, keepdim=True).expand_as(g) for g in groups], 1)
    return (squared_errors(prediction, target, views.lods) / norm).mean()
