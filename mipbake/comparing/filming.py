"""Films of a comparison: every candidate's frames, one reference for all, and the figures of each.

A film's reference takes more samples until the noise of what is displayed is small beside the error of the closest
candidate. Figures that take its halves apart see none of that noise.

All measures are taken over the interior, as the measures of renders are (`mipbake.comparing.pictures`). Measures that
look at whole pictures see the reference itself outside of it, even in the candidate.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.base.timings import Progress
from mipbake.comparing.films import FRAMES_PER_SECOND, Film
from mipbake.comparing.meshes.mesh_render import film_candidate
from mipbake.comparing.meshes.supersampling import Supersampling
from mipbake.comparing.meshes.visible import Shot
from mipbake.comparing.pictures import RESOLVED_SHARE, RenderSettings, looked_at
from mipbake.comparing.result import Filmed, FilmedScene
from mipbake.comparing.scenes import median_lod
from mipbake.material.filtered_source import FilteredSource
from mipbake.quality.figures import Candidate, Figure
from mipbake.quality.metrics import (
    PIXELS_PER_DEGREE_OF_FILMS,
    check_color_video_vdp,
    color_video_vdp,
    displayed,
    false_sparkle,
    film_exposure,
    flicker_ratio,
    flicker_snr_db,
    ldr_flip,
    snr_db,
)

JUDGED_AT = PIXELS_PER_DEGREE_OF_FILMS[:1]
"""Pixels per degree of sight at which films are judged here."""

MOST_PASSES = 256
"""Most samples for each pixel of a film's reference: a film has as many pixels as ten pictures."""

UNSEEN = 1 / (255 * math.sqrt(12))
"""Noise of displayed values that is as good as none: what rounding to bytes adds. Not tuned."""

LEAST_PASSES = 32
"""Samples for each pixel that a reference starts with. Not tuned."""

_LEAST_STEP = 1.25  # times as many samples as before
_FIRST = 3  # frames that tell which methods look best
_FLIP_APART = 3  # frames from one that FLIP looks at to the next: within 1 % of all frames, on two sets for training

Frames = NDArray[np.float32]
"""(T, H, W, 3), rows from the top."""


class FilmReference:
    """A reference film, rendered and as it is displayed: sRGB-encoded x / (1 + x) of the radiance times one exposure.

    Args:
        linear: its two independent halves, linear radiance, black where nothing is.
        interior: (T, H, W) bool, where every sample saw the mesh: where measures look.

    Attributes:
        exposure: of all frames and candidates (`mipbake.quality.metrics.film_exposure`); 1 where nothing is lit.
        first, second, mean: float32 in [0, 1], the halves and their mean, displayed.
    """

    def __init__(self, linear: tuple[Frames, Frames], interior: NDArray[np.bool_]) -> None:
        self.linear, self.interior = linear, interior
        mean = np.asarray((linear[0] + linear[1]) / 2, np.float32)
        self.exposure = film_exposure(mean, interior) if (mean[interior] > 0).any() else 1.0
        self.first, self.second, self.mean = (self.displayed(each) for each in (*linear, mean))

    @property
    def noise(self) -> float:
        """Estimated root mean square error of `mean` over the interior, displayed values; 0 without interior."""
        apart = (self.first[self.interior] - self.second[self.interior]).astype(np.float64)
        return float(np.sqrt(np.mean(np.square(apart)))) / 2 if apart.size else 0.0

    def displayed(self, frames: Frames) -> Frames:
        """A film of linear radiance as it is displayed, float32 in [0, 1]."""
        return displayed(frames * np.float32(self.exposure)).astype(np.float32)

    def shown(self, frames: Frames) -> Frames:
        """The same with the reference outside of the interior: what measures look at."""
        return np.where(self.interior[..., None], self.displayed(frames), self.mean)

    def error(self, frames: Frames) -> float:
        """Estimated root mean square error of a candidate over the interior, displayed values.

        The noise of the halves drops out of their product, on average.
        """
        p, a, b = (each[self.interior].astype(np.float64) for each in (self.shown(frames), self.first, self.second))
        return math.sqrt(max(0.0, float(np.mean((p - a) * (p - b))))) if p.size else 0.0


class Take(NamedTuple):
    """A film of every candidate, by method name, and of the reference, not yet measured."""

    scene: FilmedScene
    frames: Mapping[str, Frames]
    shown: FilmReference


def film(
    scene: Film,
    source: FilteredSource,
    candidates: Sequence[Candidate],
    settings: RenderSettings,
    progress: Progress = lambda _share: None,
    named: Collection[str] | None = None,
) -> tuple[Filmed, tuple[Figure, ...]]:
    """Films a scene with every candidate, and measures those that `looked_at` says.

    Args:
        candidates: of any model, their levels starting at the source's size; different names.
        settings: as of pictures; films take no more than MOST_PASSES.
        named: methods that are measured in any case.

    Returns:
        The film, and the figures in the order of candidates and MEASURES.
    """
    found, frames, shown = taken(scene, source, candidates, settings, lambda share: progress(0.5 * share), named)
    figures: list[Figure] = []
    for index, (name, made) in enumerate(frames.items()):
        for measure, value in film_figures(made, shown).items():
            figures.append(Figure(name, measure, found.name, "", found.lod, value))
        progress(0.5 + 0.5 * (index + 1) / len(frames))
    images = {name: _bytes(shown.displayed(made)) for name, made in frames.items()}
    return Filmed(found, _bytes(shown.mean), images), tuple(figures)


def taken(
    scene: Film,
    source: FilteredSource,
    candidates: Sequence[Candidate],
    settings: RenderSettings,
    progress: Progress = lambda _share: None,
    named: Collection[str] | None = None,
) -> Take:
    """Films a scene with the candidates that `looked_at` says, and its reference once for all; arguments as `film`.

    Which look best is judged by few frames, beside a reference of few samples.
    """

    def filmed(name: str, shots: Sequence[Shot]) -> Frames:
        (each,) = (each for each in candidates if each.name == name)
        return film_candidate(shots, each.levels, each.method.model, source.wrap, settings.sampler, settings.seed)

    most, names = min(MOST_PASSES, settings.max_passes), [each.name for each in candidates]
    least = min(LEAST_PASSES, most)
    sampling = Supersampling(scene.shots, source, settings.seed, settings.cache)
    if named is not None:
        sampling.advance(least, lambda share: progress(0.2 * share))
        one, other, inside = sampling.halves()
        glance = FilmReference((one[:_FIRST], other[:_FIRST]), inside[:_FIRST])
        names = looked_at(names, lambda name: _loss(filmed(name, scene.shots[:_FIRST]), glance), named)
    frames: dict[str, Frames] = {}
    for index, name in enumerate(names):
        frames[name] = filmed(name, scene.shots)
        progress(0.2 + 0.2 * (index + 1) / len(names))

    def judged() -> tuple[tuple[FilmReference, float, bool], float]:
        first, second, interior = sampling.halves()
        shown = FilmReference((first, second), interior)
        closest = min(shown.error(each) for each in frames.values())
        wanted = max(RESOLVED_SHARE * closest, UNSEEN)
        return (shown, closest, shown.noise <= wanted), shown.noise / wanted

    shown, closest, converged = sampling.resolve(
        least, most, _LEAST_STEP, judged, lambda share: progress(0.4 + 0.6 * share)
    )
    first = scene.shots[0]
    lod = median_lod(first.mesh, first.camera, first.resolution, source.stored.shape[:2])
    found = FilmedScene(
        name=scene.name,
        title=scene.title,
        motion=scene.motion,
        sampler=str(settings.sampler),
        lod=min(max(lod, 0.0), float(len(candidates[0].levels) - 1)),
        resolution=first.resolution,
        frames=len(scene.shots),
        frames_per_second=FRAMES_PER_SECOND,
        lighting=first.lighting.name,
        exposure=shown.exposure,
        passes=sampling.passes,
        noise=shown.noise,
        candidate_error=closest,
        converged=converged,
    )
    return Take(found, frames, shown)


def _bytes(shown: Frames) -> NDArray[np.uint8]:
    return np.rint(255 * shown).astype(np.uint8)


def _loss(frames: Frames, shown: FilmReference) -> float:
    """How bad a film looks, by what judges films here."""
    film = shown.shown(frames)
    if missing_judge():
        return float(np.mean([ldr_flip(p, r).mean for p, r in zip(film, shown.mean, strict=True)]))
    return -color_video_vdp(film, shown.mean, JUDGED_AT[0], FRAMES_PER_SECOND)


def missing_judge() -> str:
    """ "" where ColorVideoVDP can judge films; else a sentence that says what is missing, and what to type."""
    try:
        check_color_video_vdp()
    except UsageError as error:
        return str(error)
    return ""


def film_measures(pixels_per_degree: Sequence[int] = JUDGED_AT) -> tuple[str, ...]:
    """Names of the measures that `film_figures` gives here, in the order of MEASURES."""
    judged = () if missing_judge() else tuple(f"jod-{ppd}" for ppd in pixels_per_degree)
    return ("snr", "flip", "sparkle", "flicker", "flicker-snr", *judged)


def film_figures(
    frames: Frames, shown: FilmReference, pixels_per_degree: Sequence[int] = JUDGED_AT
) -> dict[str, float]:
    """Measures a candidate's film: name in MEASURES to the figure; nan where no pixel lies wholly on the mesh.

    SNR and both figures of change take the reference's halves apart, so that its noise biases none of them; the other
    measures take their mean. SNR is of linear light, the others are of what is displayed. Change is from frame to
    frame, of pixels that are inside in all frames.

    Args:
        frames: (T, H, W, 3) linear radiance, T at least 2.
        pixels_per_degree: of visual angle, at which ColorVideoVDP judges where it is installed; empty for no judgement.
    """
    inside = shown.interior
    if not inside.any():
        return dict.fromkeys(film_measures(pixels_per_degree), math.nan)
    film = shown.shown(frames)
    some = slice(None, None, _FLIP_APART)
    flip = np.stack([ldr_flip(p, r).per_pixel for p, r in zip(film[some], shown.mean[some], strict=True)])
    both, judged = inside.all(0), () if missing_judge() else pixels_per_degree
    moving = [each[:, both] for each in (film, shown.first, shown.second)]
    return {
        "snr": snr_db(frames[inside], shown.linear[0][inside], shown.linear[1][inside]),
        "flip": float(flip[inside[some]].mean(dtype=np.float64)) if inside[some].any() else math.nan,
        "sparkle": false_sparkle(film, shown.mean).mean_over(inside),
        "flicker": flicker_ratio(*moving) if both.any() else math.nan,
        "flicker-snr": flicker_snr_db(*moving) if both.any() else math.nan,
        **{f"jod-{ppd}": color_video_vdp(film, shown.mean, ppd, FRAMES_PER_SECOND) for ppd in judged},
    }
