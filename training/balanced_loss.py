"""The loss of `mipbake-1`: a decibel counts the same for every patch, level of detail and pair set.

As in loss.py a patch is a torus, seen by pixels at random places, and its noisy reference is the pixel-filtered render
of level 0, estimated twice, independently. What differs:

- Every squared error is divided by the error of its patch, level of detail and pair set as the network is now, without
  the noise of the noisy reference: the gradient equals the gradient of the mean error in decibels.
- Pairs carry importance weights for both pair sets (balanced_pairs.py); rooms add the error of each light and of the
  sum over the lights: pixel by pixel, over 4 x 4 pixels, and in brightness altogether, which eyes forgive the least.
- Coarse levels of detail have few texels: fewer pixels with many more samples each see them with much less noise.
- Some pixels are smaller than a texel. They look up level 0 as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mipbake.material.aim import ANISOTROPIC, DEFAULT_SAMPLER, FRAMES, LOOKUPS, TRILINEAR, Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import FILTERS, filter_named, slanted_axes
from mipbake.models.base import Network
from mipbake.quality.reference.estimate import estimate
from mipbake.quality.reference.lighting import GroupPairs
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.samplers import frames_at
from mipbake.sampling import texture
from mipbake.shading import shade
from mipbake.training.balanced_pairs import Pairs, draw_pairs
from mipbake.training.base import TORUS, Batch, Loss
from mipbake.training.checks import require, require_least, require_power_of_two, require_shares
from mipbake.training.picture_loss import SeenPictures, draw_pictures

_FLOOR = 3e-5  # relative error below which a render counts as right: 45 dB
_DARK, _DARK_ROOM = 1e-6, 1e-6  # squared radiance that is as good as none
_LEAST_ERROR = 0.1  # share of the mean squared difference to a noisy reference
# Pixels a side that rooms are averaged over before they are compared; None for all; docs/research.md has what they
# were measured to change.
_BLOCKS = 1, 4, None
_ROOM_FLOORS = _FLOOR, 0.1 * _FLOOR, 4e-4  # relative error below which each counts as right; in brightness 2 %
_OWN = 0.1  # share of the mean error of a patch's rooms, added to each light's error: none has all the weight


@dataclass(frozen=True)
class Band:
    """A range of levels of detail and how it is sampled.

    Args:
        low, high: levels of detail, uniform between them; below 0 pixels are smaller than texels.
        lods: drawn for each patch. side: pixels a side of each.
        samples: samples of a pixel of the noisy reference. groups: groups of pairs with lookups of their own.
    """

    low: float
    high: float
    lods: int
    side: int
    samples: int
    groups: int


_BIASES = 0.0, -0.3, -0.5, -1.0, -1.58
"""MIP biases of engines that accumulate frames or upscale."""

BANDS = (Band(-0.7, 1.5, 2, 32, 2, 3), Band(1.5, 3.0, 1, 16, 8, 2), Band(3.0, 5.5, 2, 8, 32, 1))
"""The bands for patches of 32 x 32 texels; other patches have as many levels of detail between their ends."""


OTHER_SAMPLERS = (
    *(Sampler(lookups) for lookups in LOOKUPS[1:-1]),
    *(Sampler(lookups, bias, FRAMES[-1]) for lookups in LOOKUPS[:: len(LOOKUPS) - 1] for bias in _BIASES),
)
"""Samplers of engines beside TRILINEAR and ANISOTROPIC: few lookups, and frames that are accumulated."""


@dataclass(frozen=True)
class Seen:
    """What a band sees: B patches, N pixels of S levels of detail.

    Args:
        lod: (B, S F N) levels of detail of lookups. uv: (B, S F N, 2) of each pixel in each of F frames. lods: S.
        noisy_reference, independent: (B, K, S N, 3), two of them.
    """

    lod: Tensor
    uv: Tensor
    lods: int
    noisy_reference: Tensor
    independent: Tensor
    frames: int = 1


@dataclass(frozen=True)
class BalancedBatch(Batch):
    """Of one step, beside the patches."""

    pixel_filter: str
    sampler: Sampler
    pairs: Pairs
    seen: tuple[Seen, ...]
    pictures: tuple[SeenPictures, ...]


@dataclass(frozen=True)
class BalancedLossConfig(Loss[BalancedBatch]):
    """One step's batch and its loss, for networks that correct averages (mipbake.training.balanced_loss).

    Args:
        crops: material patches a step.
        crop_size: their side in texels, a power of two.
        near_mirror, hemisphere, narrow_lobes, wide_lobes: light-view pairs a patch, drawn like those pair sets, around
            the lobe of a texel and around one as wide as the patch; together a multiple of 6.
        grazing: share of the pairs whose views are drawn towards the horizon.
        rooms: views a patch that see several lights. room_lights: lights of each.
        mirror_weight, hemisphere_weight: weight of the mean errors over those pair sets.
        light_weight: weight of the errors of single lights of rooms.
        room_weight, blur_weight, mean_weight: of the errors of their sums, by pixel, over 4 x 4 pixels and over all.
        pixel_filter: filter of the noisy reference. any_filter: share of the steps with a filter drawn from all of
            them.
        below: share of the levels of detail below 0 that are kept; the others become 0.
        pictures: of each patch in every band, as people see them (picture_loss.py). picture_weight: of their errors.
        anisotropic: share of the steps whose pictures are looked up anisotropically. other_samplers: share of the steps
            with one of OTHER_SAMPLERS, for networks that take all features of the sampler.

    The defaults are guesses; docs/research.md says what some of them brought.
    """

    kind: ClassVar[str] = "balanced"

    crops: int = 4
    crop_size: int = 32
    near_mirror: int = 6
    hemisphere: int = 4
    narrow_lobes: int = 4
    wide_lobes: int = 4
    grazing: float = 0.5
    rooms: int = 2
    room_lights: int = 6
    mirror_weight: float = 1.5
    hemisphere_weight: float = 1.0
    light_weight: float = 0.5
    room_weight: float = 1.0
    blur_weight: float = 2.0
    mean_weight: float = 2.0
    pixel_filter: str = "gaussian"
    any_filter: float = 0.4
    below: float = 0.5
    pictures: int = 0
    picture_weight: float = 1.0
    anisotropic: float = 0.0
    other_samplers: float = 0.0

    def __post_init__(self) -> None:
        kinds = "near_mirror", "hemisphere", "narrow_lobes", "wide_lobes"
        weights = "mirror_weight", "hemisphere_weight", "light_weight", "room_weight", "blur_weight", "mean_weight"
        require_least(1, self, "loss", "crops", *kinds, "room_lights")
        require_least(0, self, "loss", "rooms", "pictures", "picture_weight", *weights)
        require_power_of_two("loss.crop_size", self.crop_size)
        require_shares(self, "loss", "grazing", "any_filter", "below", "anisotropic", "other_samplers")
        drawn = self.anisotropic + self.other_samplers
        require(drawn <= 1, "loss.anisotropic and loss.other_samplers", "at most 1 together", drawn)
        require(self.grazing < 1, "loss.grazing", "below 1, or no pair is seen from above", self.grazing)
        require(sum(self.kinds) % 6 == 0, "pairs of [loss], rooms' not included,", "a multiple of 6", sum(self.kinds))
        filter_named(self.pixel_filter)

    @property
    def kinds(self) -> tuple[int, int, int, int]:
        """Pairs of each kind."""
        return self.near_mirror, self.hemisphere, self.narrow_lobes, self.wide_lobes

    @property
    def pairs(self) -> int:
        """How many pairs a patch has, with the pairs of rooms."""
        return sum(self.kinds) + self.rooms * self.room_lights

    @property
    def pixel_filters(self) -> tuple[str, ...]:
        """See Loss."""
        return tuple(dict.fromkeys((self.pixel_filter, *(FILTERS if self.any_filter > 0 else ()))))

    @property
    def drawn(self) -> str:
        """See Loss."""
        return "drawn by importance for both pair sets, and for many-light views"

    def draw(self, patches: Tensor, source: str, rng: np.random.Generator) -> BalancedBatch:
        """See Loss."""
        names = list(FILTERS)
        any_filter = rng.random() < self.any_filter
        pixel_filter = names[int(rng.integers(len(names)))] if any_filter else self.pixel_filter
        pairs = draw_pairs(patches, source, self, rng)
        sources = [FilteredSource(patch.numpy(), source, TORUS, pixel_filter) for patch in patches]
        # Single lights see no difference between TRILINEAR and ANISOTROPIC.
        sampler = self._sampler(rng) if self.other_samplers else DEFAULT_SAMPLER
        seen = tuple(_seen(sources, pairs, band, self, sampler, rng) for band in BANDS)
        pictures = tuple[SeenPictures, ...]()
        if self.pictures:
            sampler = sampler if self.other_samplers else self._sampler(rng)
            bands = [band for band in BANDS for _ in range(self.pictures)]
            pictures = tuple(
                draw_pictures(sources, _lods(band, (len(sources),), self, sampler, rng), sampler, rng) for band in bands
            )
        return BalancedBatch(source, patches, pixel_filter, sampler, pairs, seen, pictures)

    def _sampler(self, rng: np.random.Generator) -> Sampler:
        """What looks up in a step."""
        place = rng.random()
        if place < self.anisotropic:
            return ANISOTROPIC
        if place < self.anisotropic + self.other_samplers:
            return OTHER_SAMPLERS[int(rng.integers(len(OTHER_SAMPLERS)))]
        return TRILINEAR

    def value(self, network: Network, batch: BalancedBatch) -> Tensor:
        """See Loss; about 1 for each of its parts."""
        stacks = network(batch.patches, batch.source, batch.pixel_filter, batch.sampler)
        lods = sum(seen.lods for seen in batch.seen)
        losses = []
        for model, levels in stacks.items():
            bands = [_band_loss(levels, model, batch, seen, self) * (seen.lods / lods) for seen in batch.seen]
            losses.append(torch.stack(bands).sum())
        total = torch.stack(losses).mean() if len(losses) > 1 else losses[0]
        if not batch.pictures:
            return total
        seen = [each.value(levels, model) for model, levels in stacks.items() for each in batch.pictures]
        return total + self.picture_weight * torch.stack(seen).mean()


def _seen(
    sources: Sequence[FilteredSource],
    pairs: Pairs,
    band: Band,
    config: BalancedLossConfig,
    sampler: Sampler,
    rng: np.random.Generator,
) -> Seen:
    batch, side, frames = len(sources), band.side, sampler.frames
    lod = _lods(band, (batch, band.lods), config, sampler, rng)
    row, column = np.divmod(np.arange(side * side, dtype=np.float32), side)
    uv = (np.stack([column, row], -1) + rng.random((batch, band.lods, side * side, 2), np.float32)) / side
    covered, centres = np.repeat(lod - np.float32(sampler.bias), side * side, 1), uv.reshape(batch, -1, 2)
    where = torch.from_numpy(covered), torch.from_numpy(centres)
    noisy_reference, independent = (
        torch.cat([_noisy_reference(sources, *where, band.samples, each, rng) for each in seen_groups(pairs, band)], 1)
        for _ in range(2)
    )
    texels = sources[0].stored.shape[0]
    axes = np.exp2(covered)[..., None, None] * np.eye(2, dtype=np.float32) / texels
    lookups = torch.from_numpy(frames_at(centres, axes, frames).astype(np.float32, copy=False))
    at = torch.from_numpy(np.repeat(lod, side * side * frames, 1))
    return Seen(at, lookups, band.lods, noisy_reference, independent, frames)


def _lods(
    band: Band, shape: tuple[int, ...], config: BalancedLossConfig, sampler: Sampler, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Levels of detail of a band's lookups; below 0 pixels look level 0 up that are smaller than texels, or that a
    negative bias brings there."""
    low = band.low + (min(sampler.bias, 0) if band.low < 0 else 0)
    lod = rng.uniform(low, band.high, shape).clip(None, config.max_lod)
    return np.where(rng.random(shape) < config.below, lod, lod.clip(0)).astype(np.float32)


class _Group(NamedTuple):
    """G groups of k pairs: lights and views (B, G, k, 3), and axes of a pixel (B, G, 2, 2); None for square pixels."""

    light: Tensor
    view: Tensor
    axes: Tensor | None = None


def seen_groups(pairs: Pairs, band: Band) -> Sequence[_Group]:
    """Groups of single pairs, and rooms, where there are any.

    Single pairs are seen by square pixels, as the measure has it. A room is seen as a slanted surface is.
    """
    batch, count = pairs.weights.shape[1:]
    single = (d[:, :count].reshape(batch, band.groups, -1, 3) for d in (pairs.light, pairs.view))
    if not pairs.rooms:
        return [_Group(*single)]
    light, view = (d[:, count:].reshape(batch, pairs.rooms, -1, 3) for d in (pairs.light, pairs.view))
    return [_Group(*single), _Group(light, view, torch.from_numpy(slanted_axes(view[:, :, 0].numpy())))]


def _noisy_reference(
    sources: Sequence[FilteredSource],
    lod: Tensor,
    uv: Tensor,
    samples: int,
    group: _Group,
    rng: np.random.Generator,
) -> Tensor:
    """(B, G k, P, 3) estimates: every group of pairs has `samples` lookups of a pixel, one low-discrepancy sequence."""
    batch, groups, count, _ = group.light.shape
    out = np.empty((batch, groups, count, uv.shape[1], 3), np.float32)
    for index, source in enumerate(sources):
        axes = None if group.axes is None else group.axes[index].numpy()[:, None]
        pixels = Pixels(uv[index].numpy(), lod[index].numpy(), axes)
        pairs = GroupPairs(group.light[index].numpy(), group.view[index].numpy())
        estimate(source, pixels, pairs, samples, rng, out[index])
    return torch.from_numpy(out.reshape(batch, groups * count, -1, 3))


def rendered(levels: list[Tensor], seen: Seen, light: Tensor, view: Tensor, model: str = "gltf") -> Tensor:
    """(B, K, S N, 3) renders of a stack of a model, looked up and shaded once a pixel."""
    uv, lod = seen.uv[:, None], seen.lod.clamp(min=0)[:, None]
    texels = texture(levels[0], uv, None, lod, levels[1:], boundary_mode=TORUS).flatten(1, 2)
    radiance = shade(model, texels, light, view)
    if seen.frames == 1:
        return radiance
    return radiance.reshape(*radiance.shape[:2], -1, seen.frames, 3).mean(3)


def _band_loss(
    levels: list[Tensor],
    model: str,
    batch: BalancedBatch,
    seen: Seen,
    config: BalancedLossConfig,
) -> Tensor:
    pairs, single = batch.pairs, batch.pairs.weights.shape[2]
    prediction = rendered(levels, seen, pairs.light, pairs.view, model)
    weights = pairs.weights[..., None]  # (2, B, K, 1)
    # Filled there and not copied: a recorded step copies nothing from the processor.
    share = torch.stack([weights.new_full((1, 1, 1), w) for w in (config.mirror_weight, config.hemisphere_weight)])
    difference, other = prediction - seen.noisy_reference, (prediction - seen.independent).detach()
    error = _squares(difference, seen.lods)
    with torch.no_grad():
        own = own_errors(difference, other, seen.lods) + _FLOOR * _squares(seen.independent, seen.lods)
        counts = (weights / ((weights * own[:, :single]).sum(2, keepdim=True) + _DARK) * share).sum(0)
        lights = own[:, single:] + _DARK
        lights = 1 / (lights + _OWN * lights.mean(1, keepdim=True))
    of_sets = (error[:, :single] * counts).sum(1).mean()
    if not config.rooms:
        return of_sets
    of_lights = (error[:, single:] * lights).mean()
    total = of_sets + config.light_weight * of_lights
    first, second, noisy = (_rooms(each, single, config) for each in (difference, other, seen.independent))
    room_weights = config.room_weight, config.blur_weight, config.mean_weight
    for weight, block, floor in zip(room_weights, _BLOCKS, _ROOM_FLOORS, strict=True):
        if weight > 0:
            total = total + weight * room_error(first, second, noisy, seen.lods, block, floor)
    return total


def room_error(
    difference: Tensor, other: Tensor, independent: Tensor, lods: int, block: int | None, floor: float
) -> Tensor:
    """Squared error of rooms, (B, R, S N, 3), after averaging over blocks of pixels, over what it is now."""
    first, second, noisy = (_averaged(radiance, lods, block) for radiance in (difference, other, independent))
    with torch.no_grad():
        own = own_errors(first, second, lods)
        own = own + floor * _squares(noisy, lods) + _DARK_ROOM
    return (_squares(first, lods) / own).mean()


def _averaged(radiance: Tensor, lods: int, block: int | None) -> Tensor:
    """(B, R, S N, 3) to means over blocks of pixels, `block` a side, or over all N for None."""
    batch, rooms, points, _ = radiance.shape
    side = math.isqrt(points // lods)
    block = side if block is None else min(block, side)
    shape = batch, rooms, lods, side // block, block, side // block, block, 3
    return radiance.reshape(shape).mean((4, 6)).reshape(batch, rooms, -1, 3)


def own_errors(first: Tensor, second: Tensor, lods: int) -> Tensor:
    """(B, K, S): mean squared errors, free of noise, from differences to two independent noisy references.

    Of materials that are nearly right most of a difference is noise: divided by its square, they would hardly count.
    The product of both has none in the mean; where chance makes it too small, a share of the square holds.
    """
    batch, pairs = first.shape[:2]
    products = (first * second).reshape(batch, pairs, lods, -1).mean(-1)
    return torch.maximum(products, _LEAST_ERROR * _squares(second, lods))


def _squares(radiance: Tensor, lods: int) -> Tensor:
    """(B, K, S): mean square of each render of (B, K, S N, 3)."""
    batch, pairs = radiance.shape[:2]
    return radiance.square().reshape(batch, pairs, lods, -1).mean(-1)


def _rooms(radiance: Tensor, single: int, config: BalancedLossConfig) -> Tensor:
    """(B, R, S N, 3): means over the lights of each room."""
    batch, _, *rest = radiance.shape
    return radiance[:, single:].reshape(batch, config.rooms, config.room_lights, *rest).mean(2)
