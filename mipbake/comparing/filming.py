"""Films of a comparison: every candidate's frames, one reference for all, and the figures of each.

A film's reference takes more samples until the noise of what is displayed is small beside the error of the closest
candidate. Figures that take its halves apart see none of that noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.film_figures import ShownReference, film_figures
from mipbake.comparing.films import FRAMES_PER_SECOND, RESOLUTION, FilmScene, Motion, mesh_films, standard_films
from mipbake.comparing.meshes.film import FilmSampling, Frames, film_candidate
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.mesh_render import Cache
from mipbake.comparing.pictures import RenderSettings
from mipbake.comparing.result import Filmed, FilmedScene
from mipbake.comparing.scenes import median_lod
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.environment import Lighting
from mipbake.quality.figures import Candidate, Figure

MOST_PASSES = 256
"""Most samples for each pixel of a film's reference: a film has as many pixels as ten pictures."""

RESOLVED_SHARE = 0.2
"""Noise of a reference that is small enough, as a share of the closest candidate's error: it makes that error 2 %
larger."""

UNSEEN = 1 / (255 * math.sqrt(12))
"""Noise of displayed values that is as good as none: what rounding to bytes adds. Not tuned."""

LEAST_PASSES = 96
"""Samples for each pixel that a reference starts with. Not tuned."""

_LEAST_STEP = 1.25  # times as many samples as before


@dataclass(frozen=True)
class FilmSettings:
    """How films are made.

    Args:
        renders: how frames are rendered, as pictures are.
        motion: what moves.
    """

    renders: RenderSettings
    motion: Motion = "camera"


def film_view(scene: str) -> str:
    """What figures of a film have as their view: `film-floor` for the scene `floor`."""
    return f"film-{scene}"


def films_of(
    size: tuple[int, int], lighting: Lighting, last_level: int, mesh: Mesh | None, motion: Motion, side: int
) -> tuple[FilmScene, ...]:
    """The films of a texture of `size` (height, width), at most `side` pixels high: films of the mesh, if there is one.

    Raises:
        InputError: a mesh that cannot be seen.
    """
    height = min(RESOLUTION[0], side)
    resolution = height, height * RESOLUTION[1] // RESOLUTION[0]
    if mesh:
        return mesh_films(mesh, size, lighting, motion, resolution=resolution)
    return standard_films(size, lighting, last_level, motion, resolution=resolution)


@dataclass(frozen=True, eq=False)
class Take:
    """A film of every candidate and of the reference, not yet measured.

    Args:
        scene: what they show.
        frames: method name to the candidate's frames.
        shown: the reference.
    """

    scene: FilmedScene
    frames: Mapping[str, Frames]
    shown: ShownReference


def film(
    scene: FilmScene,
    source: FilteredSource,
    candidates: Sequence[Candidate],
    settings: FilmSettings,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Filmed, tuple[Figure, ...]]:
    """Films a scene with every candidate, and measures.

    Args:
        source: what the reference filters.
        candidates: of any model, their levels starting at the source's size; different names.
        progress: told the finished share.

    Returns:
        The film, and the figures in the order of candidates and MEASURES.
    """
    take = taken(scene, source, candidates, settings, lambda share: progress(0.5 * share))
    found, shown = take.scene, take.shown
    figures: list[Figure] = []
    for index, (name, made) in enumerate(take.frames.items()):
        for measure, value in film_figures(made, shown).by_measure.items():
            figures.append(Figure(name, measure, found.name, "", found.lod, value, math.nan, math.nan))
        progress(0.5 + 0.5 * (index + 1) / len(take.frames))
    images = {name: _bytes(shown.displayed(made)) for name, made in take.frames.items()}
    return Filmed(found, _bytes(shown.mean), images), tuple(figures)


def taken(
    scene: FilmScene,
    source: FilteredSource,
    candidates: Sequence[Candidate],
    settings: FilmSettings,
    progress: Callable[[float], None] = lambda _share: None,
) -> Take:
    """Films a scene with every candidate, and its reference once for all; arguments as `film`."""
    looks = settings.renders
    frames: dict[str, Frames] = {}
    for index, each in enumerate(candidates):
        levels, model = each.levels, each.method.model
        frames[each.method.name] = film_candidate(scene.film, levels, model, source.wrap, looks.sampler, looks.seed)
        progress(0.4 * (index + 1) / len(candidates))
    shown, closest = _reference(scene, source, list(frames.values()), looks, lambda share: progress(0.4 + 0.6 * share))
    found = FilmedScene(
        name=film_view(scene.name),
        title=scene.title,
        motion=settings.motion,
        sampler=str(looks.sampler),
        lod=_lod(scene, source, len(candidates[0].levels) - 1),
        resolution=scene.film.resolution,
        frames=len(scene.film.cameras),
        frames_per_second=FRAMES_PER_SECOND,
        lighting=scene.film.lightings[0].name,
        exposure=shown.exposure,
        passes=shown.linear.passes,
        noise=shown.noise,
        candidate_error=closest,
        converged=shown.noise <= _wanted(closest),
    )
    return Take(found, frames, shown)


def _reference(
    scene: FilmScene,
    source: FilteredSource,
    frames: Sequence[Frames],
    looks: RenderSettings,
    progress: Callable[[float], None],
) -> tuple[ShownReference, float]:
    """The reference, and the error of the closest candidate."""
    sampling = FilmSampling(scene.film, source, looks.seed, Cache(looks.cache) if looks.cache else None)
    most = min(MOST_PASSES, looks.max_passes)
    passes, before = max(min(LEAST_PASSES, most), sampling.passes), 0

    def told(share: float) -> None:
        progress((before + share * (passes - before)) / max(most, passes))

    while True:
        sampling.advance(passes, told)
        shown = ShownReference.of(sampling.reference())
        closest = min(shown.error(each) for each in frames)
        if shown.noise <= _wanted(closest) or passes >= most:
            progress(1.0)
            return shown, closest
        # The noise falls at least with the root of the number of samples; what seems needed, but no more than double.
        # Steps are not too small, lest one of many rough estimates is low by chance.
        needed = passes * min(2.0, max(_LEAST_STEP, (shown.noise / _wanted(closest)) ** 2))
        before, passes = passes, min(2 * math.ceil(needed / 2), most)


def _wanted(error: float) -> float:
    return max(RESOLVED_SHARE * error, UNSEEN)


def _lod(scene: FilmScene, source: FilteredSource, last: int) -> float:
    shot = scene.film.shots[0]
    lod = median_lod(shot.mesh, shot.camera, shot.resolution, source.stored.shape[:2])
    return min(max(lod, 0.0), float(last))


def _bytes(shown: Frames) -> NDArray[np.uint8]:
    return np.rint(255 * shown).astype(np.uint8)
