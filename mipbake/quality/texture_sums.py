"""What light-view pairs add to the sums of measures in texture space, some blocks of pairs at a time.

With A and B two independent estimates of the reference, M = (A + B) / 2 and D = (A - B) / 2,

    (P - A)(P - B) = (P - M)^2 - D^2,    AB = M^2 - D^2:

what does not depend on the candidate is summed once, and a candidate takes one pass over its radiance. The sums are
the sums of `mipbake.quality.metrics.snr_sums` and `mipbake.quality.metrics.flicker.flicker_sums`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mipbake.material.aim import Sampler
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.figures import Candidate
from mipbake.quality.metrics import PAIR_SETS
from mipbake.quality.metrics.images import displayed
from mipbake.quality.metrics.pairs import BLOCK, PAIRS
from mipbake.quality.reference.estimate import estimate
from mipbake.quality.reference.lighting import GroupPairs
from mipbake.quality.reference.pair_sets import weighted_pair_set
from mipbake.quality.reference.samples import Pixels
from mipbake.quality.reference.sequences import random_points
from mipbake.quality.round_lookups import lookup
from mipbake.quality.samplers import over_frames
from mipbake.shading import shade

SHIFTS = ((0.5, 0.0), (0.0, 0.5))
"""How far pixels move for flicker, in pixels: along u, and along v. Not tuned: flicker is defined by half a pixel."""

BLOCKS = PAIRS // BLOCK
"""Blocks of the pairs of a set."""

# Encoding costs far more than a lookup, and no square gives few bright pixels all the weight.
_TONE_POINTS = 2048

Radiance = NDArray[np.float32]
"""(B, K, P, 3) linear radiance of P pixels of each of B blocks, under K light-view pairs of the block."""

Sums = NDArray[np.float64]
"""(..., K, M): what each light-view pair adds to the M sums of a measure, its weight included."""

Found = tuple[tuple[str, str, float], Sums]
"""Measure, method and level of detail, and (B, K, M) sums of blocks of pairs."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The source under its pixel filter, and some blocks of light-view pairs: BLOCK of every set, one set after the
    other.

    Args:
        weights: (B, K) of the pairs in means over their sets. sampler: that looks candidates up.
    """

    source: FilteredSource
    lighting: GroupPairs
    weights: NDArray[np.float64]
    sampler: Sampler

    def __getitem__(self, some: slice) -> Scene:
        """Some of the blocks."""
        lighting = GroupPairs(self.lighting.light[some], self.lighting.view[some])
        return Scene(self.source, lighting, self.weights[some], self.sampler)

    def estimate(self, uv: NDArray[np.float64], lod: float, draws: Draws) -> Radiance:
        return estimate(self.source, Pixels(uv, lod), self.lighting, draws.samples, draws.rngs)

    def shown(self, each: Candidate, uv: NDArray[np.float64], lod: float) -> Radiance:
        """What a candidate shows at each of (B, P, 2) uv: one trilinear lookup, shaded once; of every frame."""
        height, width = self.source.stored.shape[:2]
        pixel = 2**lod / np.array([width, height])

        def frame(shift: tuple[float, float]) -> Radiance:
            here = (uv + shift * pixel if any(shift) else uv).reshape(-1, 2)
            texels = lookup(each.levels, here, lod + self.sampler.bias, self.source.wrap).reshape(*uv.shape[:2], -1)
            return shade(each.method.model, texels, self.lighting.light, self.lighting.view)

        return over_frames(self.sampler, frame)

    def weighed(self, sums: Sums) -> Sums:
        """(B, K, M) sums of pairs, as they add up for their sets."""
        return np.asarray(sums * self.weights[..., None])


class Draws(NamedTuple):
    """How many pixels are drawn for each block, how many samples of each pixel, and by whom: one for each block."""

    points: int
    samples: int
    rngs: Sequence[np.random.Generator]

    @property
    def uv(self) -> NDArray[np.float64]:
        """(B, P, 2) pixels, drawn anew."""
        return np.stack([random_points(rng, self.points) for rng in self.rngs])


def whole_scene(source: FilteredSource, seed: int, sampler: Sampler) -> Scene:
    """All pairs, in BLOCKS blocks."""
    sets = [weighted_pair_set(name, seed, source.stored, source.model) for name in PAIR_SETS]
    light, view = (
        np.concatenate([getattr(pairs, name).reshape(BLOCKS, BLOCK, 3) for pairs in sets], 1)
        for name in ("light", "view")
    )
    weights = np.concatenate([pairs.weights.reshape(BLOCKS, BLOCK) for pairs in sets], 1)
    return Scene(source, GroupPairs(light, view), weights, sampler)


def a_block(points: int) -> int:
    """How many of so many points a block of pairs has."""
    return max(1, points // BLOCKS)


def at_rest(scene: Scene, candidates: Sequence[Candidate], lod: float, draws: Draws, tones: bool) -> Iterator[Found]:
    """The SNR of blocks at a level of detail, and the tonemapped error where it is wanted."""
    uv = draws.uv
    compared = _Compared(*(scene.estimate(uv, lod, draws) for _ in range(2)))
    some = a_block(_TONE_POINTS)
    toned = displayed(compared.mean[:, :, :some]) if tones else None
    for each in candidates:
        shown = scene.shown(each, uv, lod)
        yield ("snr", each.name, lod), scene.weighed(compared.snr_sums(shown))
        if toned is not None:
            apart = np.abs(displayed(shown[:, :, :some]) - toned).sum((2, 3))
            sums = np.stack([apart, np.full_like(apart, toned[0, 0].size)], -1)
            yield ("tonemapped", each.name, lod), scene.weighed(sums)


def in_motion(scene: Scene, candidates: Sequence[Candidate], lod: float, draws: Draws) -> Iterator[Found]:
    """Flicker and the SNR of the change of blocks at a level of detail, both shifts together.

    Sums are for one pixel: levels of detail take different numbers of pixels, and count alike where a scale pools
    them.
    """
    height, width = scene.source.stored.shape[:2]
    uv = draws.uv
    places = [uv, *(uv + np.array(shift) * 2**lod / [width, height] for shift in SHIFTS)]
    first, second = ([scene.estimate(place, lod, draws) for place in places] for _ in range(2))
    compared = [_Compared(*(of[moved] - of[0] for of in (first, second))) for moved in range(1, len(places))]
    del first, second
    for each in candidates:
        start, *ends = (scene.shown(each, place, lod) for place in places)
        changes = [end - start for end in ends]
        both = list(zip(compared, changes, strict=True))
        flicker = np.sum([of.flicker_sums(change) for of, change in both], 0)
        snr = np.sum([of.snr_sums(change) for of, change in both], 0)
        yield ("flicker", each.name, lod), scene.weighed(flicker) / draws.points
        yield ("flicker-snr", each.name, lod), scene.weighed(snr) / draws.points


class _Compared:
    """What a candidate is compared with: the mean of two independent estimates, and what they say of it."""

    def __init__(self, first: Radiance, second: Radiance) -> None:
        self.mean: Radiance = (first + second) / np.float32(2)
        self.noise = _squares(first - second) / 2
        self.signal = _squares(self.mean) - self.noise / 2

    def snr_sums(self, shown: Radiance) -> Sums:
        """(B, K, 3) as snr_sums has them."""
        return np.stack([self.signal, _squares(shown - self.mean) - self.noise / 2, self.noise], -1)

    def flicker_sums(self, shown: Radiance) -> Sums:
        """(B, K, 3) as flicker_sums has them, where both this and what is shown are changes."""
        return np.stack([_squares(shown), self.signal, self.noise], -1)


def _squares(radiance: Radiance) -> NDArray[np.float64]:
    """(B, K) sums of squares; in float32 along a row, which is exact to 1e-5."""
    rows = radiance.reshape(*radiance.shape[:2], 1, -1)
    return np.asarray((rows @ rows.swapaxes(2, 3))[:, :, 0, 0], np.float64)
