"""What stacks are off by at probes, from looked-up texels alone.

Ingredients are looked up once at all points. A level that blends ingredients blends what was looked up, since lookups
are linear in stored channels, so blends cost a shading each and no images.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.base.threads import side_by_side
from mipbake.quality.judging.pairs import KINDS
from mipbake.quality.judging.probes import Probe, ProbeEffort, mean_squares, probe
from mipbake.quality.judging.terms import ARRAYS, Array
from mipbake.quality.metrics.pairs import PAIR_SETS
from mipbake.quality.metrics.visible import VisibleError
from mipbake.quality.reference.estimate import bilinear
from mipbake.quality.reference.problem import Image, Problem, Region, whole
from mipbake.quality.samplers import mean_of_frames
from mipbake.shading import shade

DECIBEL = 10 / math.log(10)  # in a neper of energy: not tuned
UNLIT = 1e-12  # mean square radiance below which nothing is seen
_STREAM = 15485863  # keeps these pairs apart from every set that pair_set draws; a seed
_FLOOR = 1e-7  # error in units of the signal that is as good as none
# Share of the reference's noise energy below which an error is chance (metrics.snr); of that measure: not tuned here.
_RESOLVED = 0.01
_RADIANCES = 1 << 16  # at a time: they stay in the cache


@dataclass(frozen=True, eq=False)
class Score:
    """What a stack is off by at a level of detail.

    Args:
        log_errors: (S, G) natural logarithms of the error relative to the signal, of S pair sets and G groups.
        pooled: (2 S, H) of the energy of the errors under bright pairs of each kind relative to the energy of the
            signal; values whose mean is its logarithm, and whose scatter says how sure (Tukey's pseudo-values, the
            jackknife over groups, moved to that mean).
        visible: (V, N) VisibleError.pseudo_values of each kind of small pictures: their mean is the log of the error.
    """

    log_errors: Array
    pooled: Array
    visible: Array

    @property
    def terms(self) -> Array:
        """(T,) values of TERMS."""
        return np.concatenate([getattr(self, array).mean(-1) for array in ARRAYS])

    @property
    def decibels(self) -> Array:
        """(S,) SNR, the mean over groups."""
        return np.asarray(-DECIBEL * self.log_errors.mean(1))


@dataclass(frozen=True, eq=False)
class Errors:
    """What a stack is off by at a probe, before logarithms are taken.

    Args:
        probe: where.
        squares: (G, K) mean square error of every pair over points and colours, without the noise of the reference.
        visible: of small pictures.
    """

    probe: Probe
    squares: Array
    visible: VisibleError

    @property
    def energies(self) -> Array:
        """(3, S, G) of the errors, of the noise of the reference and of the signal."""
        return np.stack([self.probe.energies(self.squares), *self.probe.reference_energies])

    @property
    def score(self) -> Score:
        """Logarithms of the errors, group by group."""
        own, pooled = np.split(self.energies, [self.probe.groups], -1)
        return Score(np.log(_relative(own)), _pseudo_values(pooled), self.visible.pseudo_values)

    def slopes(self, by_log: Array, by_pooled: Array) -> Array:
        """(S, G) derivatives by the energies of groups of what hangs on the score.

        Args:
            by_log: (S, G) its derivatives by log_errors. by_pooled: (2 S,) by the means of pooled.
        """
        energies, own = self.energies, self.probe.groups
        signal = energies[2]
        at_least = _relative(energies[..., :own]) * signal[:, :own]
        out = np.empty(signal.shape)
        # Unlit pairs have no figure, so nothing to gain either.
        out[:, :own] = np.where(signal[:, :own] > UNLIT, by_log / np.maximum(at_least, 1e-20), 0.0)
        parts = np.split(signal[:, own:], KINDS, -1)
        total = np.concatenate([part.sum(1) for part in parts])
        pooled = np.exp(_pseudo_values(energies[..., own:]).mean(1)) * total
        each = np.where(total > UNLIT, by_pooled / np.maximum(pooled, 1e-20), 0.0).reshape(KINDS, -1)
        out[:, own:] = np.repeat(each.T, parts[0].shape[1], 1)
        return out


class Scores:
    """Probes of the levels of detail of a problem, and what looked-up texels are off by there.

    Args:
        lods: levels of detail; all of them in steps of 1/2 where they are None.
        region: where the probes lie; everywhere where it is None.
    """

    def __init__(
        self,
        problem: Problem,
        effort: ProbeEffort,
        seed: int | Sequence[int],
        lods: Sequence[float] | None = None,
        region: Region | None = None,
    ) -> None:
        self.problem, self.effort = problem, effort
        self.lods = [lod / 2 for lod in range(2 * problem.last + 1)] if lods is None else list(lods)
        where = whole(problem) if region is None else region
        seeds = [seed] if isinstance(seed, int) else seed
        self.probes = side_by_side(
            lambda lod: probe(problem, where, lod, effort, np.random.default_rng([_STREAM, *seeds, round(2 * lod)])),
            self.lods,
        )

    def places(self, index: int) -> Array:
        """(M, 2) uv of all lookups of a probe: of its points, and then the lookups of the pixels of its small pictures,
        first of the pictures that make fewer of each pixel."""
        probe = self.probes[index]
        shown = (probe.shown.pictures.looked_up_at(*each).reshape(-1, 2) for each in self._alike(probe))
        return np.concatenate([probe.uv.reshape(-1, 2), *shown])

    def seen(self, lookups: Image, index: int) -> Image:
        """(N, C): what a probe sees, of (M, C) lookups at its `places`: what is shaded at its points and at the points
        of its small pictures, frame by frame."""
        probe, channels = self.probes[index], lookups.shape[-1]
        single, pictures = probe.uv.shape[0] * probe.uv.shape[1], probe.shown.pictures
        out = np.empty((single + len(pictures.uv) * pictures.points, channels), np.float32)
        out[:single] = lookups[:single]
        points, begin = out[single:].reshape(-1, pictures.points, channels), single
        for some, count in self._alike(probe):
            size = len(some) * pictures.points * count
            own = lookups[begin : begin + size].reshape(len(some), pictures.points, count, channels)
            points[some] = own.mean(2) if count > 1 else own[:, :, 0]
            begin += size
        return out

    def looked_up(self, level: Image, index: int) -> Image:
        """(N, C): what a probe sees of a level, which is looked up bilinearly."""
        return self.seen(bilinear(level, self.places(index), self.problem.wrap), index)

    @staticmethod
    def _alike(probe: Probe) -> Iterator[tuple[NDArray[np.intp], int]]:
        """Indices of the pictures that make as many lookups of each pixel, and how many."""
        lookups = probe.shown.pictures.lookups
        for count in np.unique(lookups).tolist():
            yield np.flatnonzero(lookups == count), count

    def errors(self, texels: Image, index: int) -> Errors:
        """What (N, C) stored channels of the target are off by at a probe, as `looked_up` has them."""
        probe, model = self.probes[index], self.problem.target
        groups, points = probe.uv.shape[:2]
        single = texels[: groups * points].reshape(groups, points, -1)
        squares = np.empty(probe.noise.shape)
        for some in blocks(probe):
            squares[some] = mean_squares(off_by(probe, model, single, some))
        shown = probe.shown
        pictures = texels[groups * points :].reshape(-1, shown.pictures.points, texels.shape[-1])
        radiance = shown.pictures.radiance(model, pictures)
        return Errors(probe, squares - probe.noise, shown.error(radiance))

    def of(self, texels: Image, index: int) -> Score:
        """The score of looked-up texels, as `errors` takes them."""
        return self.errors(texels, index).score

    def stack_errors(self, levels: Sequence[Image]) -> list[Errors]:
        """What a stack is off by at every probe."""

        def errors(index: int) -> Errors:
            seen = [self.looked_up(levels[level], index) for level in self.probes[index].levels]
            # Halfway between two levels, a lookup is the mean of both.
            return self.errors(seen[0] if len(seen) == 1 else (seen[0] + seen[1]) / np.float32(2), index)

        return side_by_side(errors, range(len(self.probes)))

    def of_stack(self, levels: Sequence[Image]) -> list[Score]:
        """The scores of a stack at every probe."""
        return [each.score for each in self.stack_errors(levels)]


def off_by(probe: Probe, model: str, texels: Image, some: slice) -> Image:
    """(G', K, P, 3) what some groups of (G, P frames, C) looked-up texels are off by at the points of a probe."""
    off = mean_of_frames(shade(model, texels[some], probe.light[some], probe.view[some]), probe.frames)
    off -= probe.mean[some]
    return off


def blocks(probe: Probe) -> list[slice]:
    """Groups of a probe that are rendered at a time."""
    groups, pairs, points, _ = probe.mean.shape
    step = max(1, _RADIANCES // (pairs * points * probe.frames))
    return [slice(start, start + step) for start in range(0, groups, step)]


def snr_text(snr: Array) -> str:
    """`near-mirror 21.3 dB, hemisphere 24.1 dB`."""
    return ", ".join(f"{name} {value:.1f} dB" for name, value in zip(PAIR_SETS, snr, strict=True))


def _relative(energies: Array) -> Array:
    """Errors in units of their signal, of (3, ...) energies as `Errors` has them; 1 where nothing is lit."""
    error, noise, signal = energies
    ratio = np.maximum(error, 2 * _RESOLVED * noise) / np.maximum(signal, 1e-30)
    return np.where(signal > UNLIT, np.maximum(ratio, _FLOOR), 1.0)


def _pseudo_values(energies: Array) -> Array:
    """(2 S, H) values of the logarithms of the pooled errors, as Score.pooled, of (3, S, G') energies of them."""
    parts = np.concatenate(np.split(energies, KINDS, -1), 1)  # (3, 2 S, H)
    total, count = parts.sum(-1), parts.shape[-1]
    whole = np.log(_relative(total))[:, None]
    values = count * whole - (count - 1) * np.log(_relative(total[..., None] - parts))
    # Their own mean may fall while an error rises, where one group rules the others.
    return np.asarray(values - values.mean(-1, keepdims=True) + whole)
