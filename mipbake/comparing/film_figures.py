"""The measures of one film and one candidate, and the reference that they are taken against, as a display shows both.

All measures are taken over the interior, as the measures of renders are (`mipbake.comparing.pictures`). Measures that
look at whole pictures see the reference itself outside of it, even in the candidate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.comparing.films import FRAMES_PER_SECOND
from mipbake.comparing.meshes.film import FilmReference, Frames
from mipbake.quality.metrics import (
    MEASURES,
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


@dataclass(frozen=True, eq=False)
class ShownReference:
    """A reference film as it is displayed: sRGB-encoded x / (1 + x) of the radiance times one exposure.

    Args:
        linear: the film, linear radiance.
        first, second, mean: (T, H, W, 3) float32 in [0, 1], its two halves and their mean, displayed.
        exposure: of all frames, and of all candidates that are compared with them.
    """

    linear: FilmReference
    first: Frames
    second: Frames
    mean: Frames
    exposure: float

    @staticmethod
    def of(reference: FilmReference) -> ShownReference:
        """The film at its own exposure (`mipbake.quality.metrics.film_exposure`); 1 where nothing of the surface is
        lit."""
        frames, inside = reference.frames, reference.interior
        exposure = film_exposure(frames, inside) if (frames[inside] > 0).any() else 1.0
        first, second, mean = (_shown(each, exposure) for each in (reference.first, reference.second, frames))
        return ShownReference(reference, first, second, mean, exposure)

    @property
    def interior(self) -> NDArray[np.bool_]:
        """(T, H, W), where measures look."""
        return self.linear.interior

    @property
    def noise(self) -> float:
        """Estimated root mean square error of `mean` over the interior, displayed values; 0 without interior."""
        apart = (self.first[self.interior] - self.second[self.interior]).astype(np.float64)
        return float(np.sqrt(np.mean(np.square(apart)))) / 2 if apart.size else 0.0

    def displayed(self, frames: Frames) -> Frames:
        """(T, H, W, 3) float32 in [0, 1]: a candidate as it is displayed."""
        return _shown(frames, self.exposure)

    def shown(self, frames: Frames) -> Frames:
        """The same with the reference outside of the interior: what measures look at."""
        return np.where(self.interior[..., None], self.displayed(frames), self.mean)

    def error(self, frames: Frames) -> float:
        """Estimated root mean square error of a candidate over the interior, displayed values.

        The noise of the halves drops out of their product, on average.
        """
        p, a, b = (each[self.interior].astype(np.float64) for each in (self.shown(frames), self.first, self.second))
        return math.sqrt(max(0.0, float(np.mean((p - a) * (p - b))))) if p.size else 0.0


@dataclass(frozen=True)
class FilmFigures:
    """What was measured; nan where no pixel lies wholly on the mesh.

    Args:
        jod: ColorVideoVDP by pixels per degree; empty where cvvdp is not installed.
        flip: mean over frames and interior.
        sparkle: false sparkle, the same mean.
        snr: of linear light, dB.
        flicker, flicker_snr: of the displayed film, from frame to frame where both frames' interior is; dB the second.
    """

    jod: Mapping[int, float]
    flip: float
    sparkle: float
    snr: float
    flicker: float
    flicker_snr: float

    @property
    def by_measure(self) -> dict[str, float]:
        """Name in MEASURES to the figure, in the order of MEASURES."""
        found = {
            "snr": self.snr,
            "flip": self.flip,
            "sparkle": self.sparkle,
            "flicker": self.flicker,
            "flicker-snr": self.flicker_snr,
            **{f"jod-{ppd}": value for ppd, value in self.jod.items()},
        }
        return {name: found[name] for name in MEASURES if name in found}


def missing_judge() -> str:
    """ "" where ColorVideoVDP can judge films; else a sentence that says what is missing, and what to type."""
    try:
        check_color_video_vdp()
    except UsageError as error:
        return str(error)
    return ""


def film_measures() -> tuple[str, ...]:
    """Names of the measures that `film_figures` gives here, in the order of MEASURES."""
    judged = {} if missing_judge() else dict.fromkeys(PIXELS_PER_DEGREE_OF_FILMS, 0.0)
    return tuple(FilmFigures(judged, 0.0, 0.0, 0.0, 0.0, 0.0).by_measure)


def film_figures(
    frames: Frames, shown: ShownReference, pixels_per_degree: Sequence[int] = PIXELS_PER_DEGREE_OF_FILMS
) -> FilmFigures:
    """Measures a candidate's film.

    SNR and both figures of change take the reference's halves apart, so that its noise biases none of them; the other
    measures take their mean.

    Args:
        frames: (T, H, W, 3) linear radiance, T at least 2.
        pixels_per_degree: of visual angle, at which ColorVideoVDP judges; empty for no judgement.
    """
    wanted = () if missing_judge() else tuple(pixels_per_degree)
    inside = shown.interior
    if not inside.any():
        nothing = math.nan
        return FilmFigures(dict.fromkeys(wanted, nothing), nothing, nothing, nothing, nothing, nothing)
    film = shown.shown(frames)
    maps = [ldr_flip(p, r).per_pixel for p, r in zip(film, shown.mean, strict=True)]
    both = inside.all(0)
    moving = [each[:, both] for each in (film, shown.first, shown.second)]
    return FilmFigures(
        jod={ppd: color_video_vdp(film, shown.mean, ppd, FRAMES_PER_SECOND) for ppd in wanted},
        flip=float(np.stack(maps)[inside].mean(dtype=np.float64)),
        sparkle=false_sparkle(film, shown.mean).mean_over(inside),
        snr=snr_db(frames[inside], shown.linear.first[inside], shown.linear.second[inside]),
        flicker=flicker_ratio(*moving) if both.any() else math.nan,
        flicker_snr=flicker_snr_db(*moving) if both.any() else math.nan,
    )


def _shown(frames: Frames, exposure: float) -> Frames:
    return displayed(frames * np.float32(exposure)).astype(np.float32)
