"""Films: pictures of a mesh, frame after frame, while the camera or the lights move a little from one to the next.

A frame of a film is what `mesh_render` renders: the once-per-pixel candidate, and the supersampled, pixel-filtered
reference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.comparing.meshes import cache as caches
from mipbake.comparing.meshes.camera import Camera
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_render import Cache, SamplePass, Shot, Supersampled, candidate, reference_key
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap
from mipbake.quality.environment import Lighting
from mipbake.quality.samplers import RenderSampler

Frames = NDArray[np.float32]
"""(T, H, W, 3) linear radiance, rows from the top."""


@dataclass(frozen=True, eq=False)
class Film:
    """What is filmed.

    Args:
        mesh: stays where it is; what turns is seen by a camera that goes round it.
        cameras, lightings: of the frames, T each.
        resolution: (height, width) in pixels.

    Raises:
        UsageError: no frame, or as many cameras as there are not lightings.
    """

    mesh: Mesh
    cameras: tuple[Camera, ...]
    lightings: tuple[Lighting, ...]
    resolution: tuple[int, int]

    def __post_init__(self) -> None:
        if not self.cameras or len(self.cameras) != len(self.lightings):
            raise UsageError(
                f"a film has {len(self.cameras)} cameras and {len(self.lightings)} lightings: expected one of each "
                "for every frame, and one frame or more"
            )

    @property
    def shots(self) -> tuple[Shot, ...]:
        """What a renderer takes of each frame."""
        return tuple(
            Shot(self.mesh, camera, lighting, self.resolution)
            for camera, lighting in zip(self.cameras, self.lightings, strict=True)
        )


@dataclass(frozen=True, eq=False)
class FilmReference:
    """The reference film: the mean of two independent, unbiased halves.

    Args:
        first, second: (T, H, W, 3) float32 linear radiance, black where nothing is.
        interior: (T, H, W) bool, where every sample saw the mesh.
        passes: samples a pixel, both halves together.
    """

    first: Frames
    second: Frames
    interior: NDArray[np.bool_]
    passes: int

    @property
    def frames(self) -> Frames:
        """(T, H, W, 3) float32, the mean of the halves."""
        return np.asarray((self.first + self.second) / 2, np.float32)


def film_candidate(
    film: Film,
    levels: Sequence[NDArray[np.float32]],
    model: str,
    wrap: Wrap,
    sampler: RenderSampler = DEFAULT_SAMPLER,
    seed: int = 0,
) -> Frames:
    """(T, H, W, 3): what an unchanged engine shows, frame after frame.

    Args:
        levels, model, wrap, sampler: as `mesh_render.candidate` takes them.
        seed: of the stochastic sampler, which draws every frame anew.
    """
    rng = np.random.default_rng(seed)
    return np.stack([candidate(shot, levels, model, wrap, sampler, rng=rng).image for shot in film.shots])


class FilmSampling:
    """The supersampled film in the making: the pixel filter's mean of level 0, interpolated bilinearly and shaded at
    each sample.

    Every frame takes as many samples a pixel, half of them for either half. All frames share the offsets of their
    samples, so that what noise there is changes as slowly as the pictures do, and hardly adds to their changes.

    Args:
        cache: where samples are kept for the next time; those found there count. None keeps none.
    """

    def __init__(self, film: Film, source: FilteredSource, seed: int = 0, cache: Cache | None = None) -> None:
        self._film, self._source, self._cache = film, source, cache
        self._key = reference_key(film.shots, source, seed, cache) if cache else ""
        kept = caches.load(cache.folder, self._key) if cache else None
        self._frames = [
            Supersampled.restored(_of_frame(kept, index), film.resolution, seed) for index in range(len(film.cameras))
        ]
        if len({frame.done for frame in self._frames}) > 1:  # a file that is not ours
            self._frames = [Supersampled.restored(None, film.resolution, seed) for _ in self._frames]

    @property
    def passes(self) -> int:
        """Samples a pixel so far, both halves together."""
        return 2 * self._frames[0].done

    def advance(self, passes: int, progress: Callable[[float], None] = lambda _share: None) -> None:
        """Takes samples until every pixel has so many, and keeps them; does nothing where it has them.

        Args:
            passes: an even number from 4 on.
            progress: told the finished share of this call.

        Raises:
            UsageError: another number of passes.
        """
        if passes % 2 or passes < 4:
            raise UsageError(f"a film takes {passes} samples a pixel: expected an even number from 4 on")
        if passes <= self.passes:
            return
        for index, (shot, frame) in enumerate(zip(self._film.shots, self._frames, strict=True)):
            render = SamplePass.of(shot, self._source)
            while 2 * frame.done < passes:
                for half in range(2):
                    render.add(frame, half)
                frame.done += 1
            progress((index + 1) / len(self._frames))
        if self._cache:
            arrays = [frame.arrays() for frame in self._frames]
            together = {name: np.stack([each[name] for each in arrays]) for name in arrays[0]}
            caches.save(self._cache.folder, self._key, together)  # without a cache it only takes as long again

    def reference(self) -> FilmReference:
        """What the samples so far show."""
        first, second, interior = (
            np.stack(each) for each in zip(*(frame.result() for frame in self._frames), strict=True)
        )
        return FilmReference(first, second, interior, self.passes)


def film_reference(film: Film, source: FilteredSource, passes: int, seed: int = 0) -> FilmReference:
    """The supersampled film of so many samples a pixel; arguments and errors as `FilmSampling`."""
    sampling = FilmSampling(film, source, seed)
    sampling.advance(passes)
    return sampling.reference()


def _of_frame(kept: Mapping[str, NDArray[Any]] | None, index: int) -> dict[str, NDArray[Any]] | None:
    """The part of a frame in arrays of all frames."""
    if kept is None or any(array.ndim == 0 or len(array) <= index for array in kept.values()):
        return None
    return {name: array[index] for name, array in kept.items()}
