"""The supersampled, pixel-filtered reference of pictures of a mesh, in the making."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mipbake.base.timings import Progress
from mipbake.base.version import __version__
from mipbake.comparing.meshes import cache as caches
from mipbake.comparing.meshes.visible import Shot, lit
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import filter_named
from mipbake.quality.reference.estimate import bilinear
from mipbake.quality.reference.sequences import SEQUENCE

FORMAT = 2
"""Version of what is kept of a pass; to be raised whenever a pass renders, or keeps, anything else."""

Arrays = dict[str, NDArray[Any]]
Found = TypeVar("Found")


class Supersampling:
    """The pixel filter's mean of level 0, interpolated bilinearly and shaded at each sample, as far as it has come.

    A pass adds a sample to each pixel of either half of every picture, at one sub-pixel offset that is
    importance-sampled from the filter. Either half takes its offsets from a low-discrepancy sequence under a random
    shift of its own. All pictures share them, so what noise there is in a film changes as slowly as the film does, and
    hardly adds to its changes. The result of so many passes is the same bits however often they were stopped and
    resumed.

    Args:
        shots: the pictures, T of one mesh in one resolution.
        source: what is filtered.
        seed: of the shifts.
        cache: folder where passes are kept for the next time, by content; those found there count. None keeps none.
    """

    def __init__(self, shots: Sequence[Shot], source: FilteredSource, seed: int = 0, cache: Path | None = None) -> None:
        self._shots, self._source, self._cache = shots, source, cache
        self._level = np.ascontiguousarray(source.stored, np.float32)
        self._kernel = filter_named(source.pixel_filter)
        pixels = math.prod(shots[0].resolution)
        self._state: Arrays = {
            "sums": np.zeros((len(shots), 2, pixels, 3)),  # weighted radiance, rows from the bottom
            "weights": np.zeros(2),
            "seen": np.zeros((len(shots), pixels), np.int32),  # how many samples of both halves saw the mesh
            "shifts": np.random.default_rng(seed).random((2, 2)),
            "done": np.array(0, np.int64),  # passes
        }
        if cache:
            self._key = _key(shots, source, seed)
            kept = caches.load(cache, self._key)
            if kept is not None and _continues(kept, self._state):
                self._state = kept

    @property
    def passes(self) -> int:
        """Samples a pixel so far, both halves together."""
        return 2 * int(self._state["done"])

    def advance(self, passes: int, progress: Progress = lambda _share: None) -> None:
        """Takes samples until every pixel has so many, and keeps them; does nothing where it has them.

        Args:
            passes: an even number.
        """
        state, steps = self._state, range(self.passes // 2, passes // 2)
        if not steps:
            return
        samples = [[self._sample(half, step) for half in range(2)] for step in steps]
        for index, shot in enumerate(self._shots):
            surface = shot.surface
            for count, pair in enumerate(samples, 1):
                for half, (offset, weight) in enumerate(pair):
                    for points in surface.bands(offset):
                        texels = bilinear(self._level, points.uv, self._source.wrap)
                        radiance = lit(points, texels, self._source.model, shot.lighting).astype(np.float64)
                        at: Any = points.index
                        if len(at) and at[-1] - at[0] + 1 == len(at):  # no gap: a slice takes a third of the time
                            at = slice(at[0], at[-1] + 1)
                        state["sums"][index, half, at] += weight * radiance
                        state["seen"][index, at] += 1
                progress((index + count / len(samples)) / len(self._shots))
        for pair in samples:
            state["weights"] += [weight for _, weight in pair]
        state["done"] = np.array(steps.stop, np.int64)
        if self._cache:
            caches.save(self._cache, self._key, state)

    def resolve(
        self,
        least: int,
        most: int,
        least_step: float,
        judged: Callable[[], tuple[Found, float]],
        progress: Progress = lambda _share: None,
    ) -> Found:
        """Takes `least` samples a pixel, and more until there is little noise, or until there are `most`.

        Args:
            least, most: even numbers.
            least_step: how many times as many samples are taken before noise is looked at again, at least. Steps that
                are too small would let one of many rough estimates end this that is low by chance.
            judged: makes something of the samples so far, and says how many times as much noise it has as is wanted.

        Returns:
            What was made last.
        """
        until, total, most_so_far = max(least, self.passes), float(most), 0.0

        def tell(share: float) -> None:
            nonlocal most_so_far
            share = (begun + share * (until - begun)) / max(total, until)
            most_so_far = max(most_so_far, share)  # more samples may be needed than it seemed
            progress(most_so_far)

        while True:
            begun = self.passes
            self.advance(until, tell)
            found, ratio = judged()
            if ratio <= 1 or self.passes >= most:
                progress(1.0)
                return found
            # Offsets of low discrepancy: the noise falls about with the number of samples, not with its root.
            total = min(float(most), self.passes * ratio)
            until = min(2 * math.ceil(self.passes / 2 * min(2.0, max(least_step, ratio))), most)

    def halves(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Two independent, unbiased estimates, (T, H, W, 3) linear radiance, black where nothing is; and the interior,
        (T, H, W), where every sample saw the mesh. Rows from the top."""
        # Signed filters' weights sum to their count on average only. Dividing by their sum keeps a constant constant,
        # and is biased by the square of the sequence's error.
        height, width = self._shots[0].resolution
        radiance = (self._state["sums"] / self._state["weights"][:, None, None]).astype(np.float32)
        halves = radiance.reshape(-1, 2, height, width, 3)[:, :, ::-1]
        interior = (self._state["seen"] == self.passes).reshape(-1, height, width)[:, ::-1]
        return halves[:, 0], halves[:, 1], interior

    def _sample(self, half: int, step: int) -> tuple[tuple[float, float], float]:
        """Offset from the pixels' centres, and weight."""
        offset, sign = self._kernel.offsets((self._state["shifts"][half] + step * SEQUENCE) % 1.0)
        return (float(offset[0]), float(offset[1])), float(sign.prod())


def _continues(kept: Arrays, start: Arrays) -> bool:
    """Whether arrays are a state of this kind."""
    return (
        all(n in kept and (kept[n].shape, kept[n].dtype) == (each.shape, each.dtype) for n, each in start.items())
        and bool(np.isfinite(kept["sums"]).all() and np.isfinite(kept["weights"]).all() and kept["done"] >= 2)
        and np.array_equal(kept["shifts"], start["shifts"])
    )


def _key(shots: Sequence[Shot], source: FilteredSource, seed: int) -> str:
    """Names by content what the passes depend on."""
    mesh = shots[0].mesh
    return caches.content_key(
        format=FORMAT,
        version=__version__,
        mesh=(mesh.positions, mesh.normals, mesh.uv, mesh.tangents, mesh.triangles),
        camera=np.concatenate([np.ravel(field) for shot in shots for field in astuple(shot.camera)]),
        lighting=tuple(array for shot in shots for array in (shot.lighting.direction, shot.lighting.radiance)),
        level=np.asarray(source.stored, np.float32),
        model=source.model,
        wrap=tuple(source.wrap),
        resolution=shots[0].resolution,
        pixel_filter=source.pixel_filter,
        seed=seed,
    )
