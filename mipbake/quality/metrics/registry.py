"""All measures, with what a report must know of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from mipbake.quality.metrics.color_video_vdp import color_video_vdp
from mipbake.quality.metrics.flicker import flicker_ratio, flicker_snr_db
from mipbake.quality.metrics.flip import hdr_flip, ldr_flip
from mipbake.quality.metrics.images import (
    ImageArray,
    Measured,
    delta_e_itp,
    false_sparkle,
    structural_similarity,
    tonemapped_error,
)
from mipbake.quality.metrics.snr import snr_db

Direction = Literal["higher", "lower", "one"]
"""Which figure is the better: the higher, the lower, or the one whose logarithm is nearer 0."""

Needs = Literal["estimates", "frames", "linear", "display", "film"]
"""What a measure compares with the candidate: `estimates`, two independent estimates of the linear reference; `frames`,
the same with a first axis of frames; `linear`, one linear reference of high dynamic range; `display`, one sRGB-encoded
reference in [0, 1], the candidate likewise; `film`, the same with a first axis of frames that follow each other in
time."""


@dataclass(frozen=True)
class Measure:
    """One measure.

    Args:
        name: key in MEASURES and in files.
        title: what a reader is shown.
        unit: of the figure; empty where it has none.
        direction: which figure is the better.
        needs: what it compares with, and so how `function` is called.
        function: (candidate, first, second) for `estimates` and `frames`, (candidate, reference, frames_per_second)
            for `film`, (candidate, reference) otherwise.
    """

    name: str
    title: str
    unit: str
    direction: Direction
    needs: Needs
    function: Callable[..., float | Measured]

    def loss(self, figure: float) -> float:
        """A number that orders figures, the smallest the best; infinite for nan, and for a ratio of 0."""
        if math.isnan(figure):
            return math.inf
        if self.direction == "one":
            return abs(math.log(figure)) if figure > 0 else math.inf
        return -figure if self.direction == "higher" else figure


PIXELS_PER_DEGREE_OF_FILMS = (37, 75)
"""Of visual angle, at which films are judged: a display of 1920 pixels on a desk, and one of 3840 pixels. Not tuned:
figures are defined by them."""


def _jod(pixels_per_degree: int) -> Measure:
    def judged(candidate: ImageArray, reference: ImageArray, frames_per_second: float) -> float:
        return color_video_vdp(candidate, reference, pixels_per_degree, frames_per_second)

    title = f"ColorVideoVDP at {pixels_per_degree} pixels per degree"
    return Measure(f"jod-{pixels_per_degree}", title, "JOD", "higher", "film", judged)


MEASURES: Mapping[str, Measure] = {
    measure.name: measure
    for measure in (
        Measure("snr", "SNR", "dB", "higher", "estimates", snr_db),
        Measure("tonemapped", "Tonemapped error", "", "lower", "linear", tonemapped_error),
        Measure("flip", "FLIP", "", "lower", "display", ldr_flip),
        Measure("hdr-flip", "HDR-FLIP", "", "lower", "linear", hdr_flip),
        Measure("delta-e-itp", "Delta E ITP", "JND", "lower", "linear", delta_e_itp),
        Measure("ssim", "SSIM", "", "higher", "display", structural_similarity),
        Measure("sparkle", "False sparkle", "", "lower", "display", false_sparkle),
        Measure("flicker", "Flicker", "", "one", "frames", flicker_ratio),
        Measure("flicker-snr", "SNR of the change", "dB", "higher", "frames", flicker_snr_db),
        *(_jod(pixels_per_degree) for pixels_per_degree in PIXELS_PER_DEGREE_OF_FILMS),
    )
}
"""Every measure by name, in the order that tables show."""
