"""Light-view pairs that stand for both pair sets at once.

What counts in a figure is the error summed over a pair set, and most of it comes from few pairs: lights that hit a
narrow lobe, views and lights that graze. Pairs drawn like the sets meet them once in dozens of patches, and a step that
has none of them is led astray. So part of the pairs are drawn where such things are, and each carries its importance
weight for each set (the balance heuristic of Veach and Guibas 1995): sums over few pairs then are calm, and unbiased
except for the few weights that are cut.

Beside them stand rooms: several lights for one view, whose sum is compared as well. Single lights hide a colour or a
brightness that is off by a few per cent everywhere; under the many lights of an environment nothing else is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.material import model_named
from mipbake.models import surface
from mipbake.models.moments import least_roughness
from mipbake.quality.metrics.pairs import cosine_directions, near_mirror_lights
from mipbake.quality.reference import lobes

Floats = NDArray[np.float32]

if TYPE_CHECKING:
    from mipbake.training.balanced_loss import BalancedLossConfig

GRAZING = 0.4
"""Cosine of the view up to which grazing views are drawn, uniformly."""

# Lobes that pairs are drawn from, so that tails are seen and densities stay finite.
_WIDER, _LEAST_ALPHA = 1.2, 0.004
_LEAST_COSINE = 2e-3  # of a light or a view in a density
# Most weight of a pair; where densities of a set are hardly covered, chance would give one pair all.
_MOST_WEIGHT = 0.5


@dataclass(frozen=True)
class Pairs:
    """K + R G pairs of each of B patches.

    Args:
        light, view: (B, K + R G, 3) unit vectors; the last R G are R rooms of G lights with one view each.
        weights: (2, B, K) of each of the first K in the mean over `near-mirror` and over `hemisphere`; they sum to
            about 1.
        rooms: R.
    """

    light: Tensor
    view: Tensor
    weights: Tensor
    rooms: int


def draw_pairs(patches: Tensor, source: str, config: BalancedLossConfig, rng: np.random.Generator) -> Pairs:
    """The pairs of (B, S, S, C) patches of a material model."""
    batch, counts = len(patches), config.kinds
    near, hemisphere, narrow, wide = counts

    def uniform(*shape: int) -> Floats:
        return rng.random(shape, np.float32)

    view, weight = _views(sum(counts), batch, config.grazing, uniform)
    narrow_lobe, wide_lobe = _lobes(patches, source, rng)
    parts = [
        near_mirror_lights(rng, view[:near].reshape(-1, 3).astype(float)).astype(np.float32).reshape(near, batch, 3),
        cosine_directions(rng, hemisphere * batch).astype(np.float32).reshape(hemisphere, batch, 3),
    ]
    start = near + hemisphere
    for lobe, count in ((narrow_lobe, narrow), (wide_lobe, wide)):
        seen = view[start : start + count]
        parts.append(lobes.reflected(seen, lobes.half_vectors(lobe, uniform(count, batch), uniform(count, batch))))
        start += count
    light = np.concatenate(parts)
    densities = lobes.near_mirror_density(light, view), lobes.hemisphere_density(light)
    mixture = near * densities[0] + hemisphere * densities[1]
    for lobe, count in ((narrow_lobe, narrow), (wide_lobe, wide)):
        mixture += count * lobes.lobe_density(lobe, light, view)
    above = light[..., 2] > 0
    weights = np.stack(densities) * (above * weight / np.maximum(mixture, 1e-9))
    light = np.where(above[..., None], light, np.array([0, 0, 1], np.float32))  # weighs nothing
    room_light, room_view = _rooms(batch, config, rng)
    return Pairs(
        torch.cat([torch.from_numpy(light).transpose(0, 1), room_light], 1).contiguous(),
        torch.cat([torch.from_numpy(view).transpose(0, 1), room_view], 1).contiguous(),
        torch.from_numpy(np.minimum(weights, _MOST_WEIGHT)).transpose(1, 2).contiguous(),
        config.rooms,
    )


def _float(directions: NDArray[np.float64]) -> Tensor:
    return torch.from_numpy(directions.astype(np.float32))


def _views(count: int, batch: int, grazing: float, uniform: Callable[..., Floats]) -> tuple[Floats, Floats]:
    """(count, batch, 3) views, part of them grazing, and (count, batch) weights that make them cosine-distributed."""
    flat = uniform(count, batch) < grazing
    cosine = np.where(flat, GRAZING * uniform(count, batch), np.sqrt(uniform(count, batch)))
    cosine = np.maximum(cosine, _LEAST_COSINE)
    density = (1 - grazing) * 2 * cosine + np.float32(grazing / GRAZING) * (cosine < GRAZING)
    sine, angle = np.sqrt(1 - cosine * cosine), 2 * math.pi * uniform(count, batch)
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], -1), 2 * cosine / density


def _lobes(patches: Tensor, source: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(B, 4) each: the lobe of one texel of each patch, and one as wide as all of the patch together.

    Lobes that are stretched count as round ones of as large an area.
    """
    model, flat = model_named(source), patches.flatten(1, 2)
    normals, roughness = surface.unit_normals(flat, model), surface.round_roughness(flat, model)
    one = torch.arange(len(flat)), torch.from_numpy(rng.integers(flat.shape[1], size=len(flat)))
    normal = normals.mean(1)
    normal = normal / normal.norm(dim=-1, keepdim=True).clamp(min=1e-3)
    slopes = normals[..., :2] / normals[..., 2:].clamp(min=0.1)
    alpha2 = roughness.clamp(min=least_roughness(model)).pow(4).mean(1) + slopes.var(1).sum(-1, keepdim=True)
    each = ((normals[one], roughness[one].square()), (normal, alpha2.sqrt()))
    narrow, wide = (torch.cat([n, (_WIDER * a).clamp(_LEAST_ALPHA, 1)], -1).numpy() for n, a in each)
    return narrow, wide


def _rooms(batch: int, config: BalancedLossConfig, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """(B, R G, 3) lights and views, both cosine-distributed."""
    rooms, lights = config.rooms, config.room_lights
    view = _float(cosine_directions(rng, batch * rooms)).reshape(batch, rooms, 1, 3)
    light = _float(cosine_directions(rng, batch * rooms * lights)).reshape(batch, rooms * lights, 3)
    return light, view.expand(-1, -1, lights, -1).flatten(1, 2)
