"""What is measured: light-view pair sets, error measures over them and over images, and their confidence intervals."""

from mipbake.quality.metrics.color_video_vdp import PERFECT_JOD, check_color_video_vdp, color_video_vdp
from mipbake.quality.metrics.flicker import flicker_ratio, flicker_ratio_from_sums, flicker_snr_db, flicker_sums
from mipbake.quality.metrics.flip import PIXELS_PER_DEGREE, Exposures, hdr_flip, hdr_flip_exposures, ldr_flip
from mipbake.quality.metrics.images import (
    NITS_PER_UNIT,
    Measured,
    delta_e_itp,
    displayed,
    false_sparkle,
    film_exposure,
    srgb_encode,
    structural_similarity,
    tonemapped_error,
)
from mipbake.quality.metrics.intervals import (
    Interval,
    bootstrap,
    flicker_interval,
    mean_interval,
    snr_gain_interval,
    snr_interval,
)
from mipbake.quality.metrics.pairs import PAIR_SETS, LightViewPairs, pair_set
from mipbake.quality.metrics.registry import MEASURES, PIXELS_PER_DEGREE_OF_FILMS, Measure
from mipbake.quality.metrics.snr import MAX_SNR_DB, snr_db, snr_from_sums, snr_sums

__all__ = [
    "MAX_SNR_DB",
    "MEASURES",
    "NITS_PER_UNIT",
    "PAIR_SETS",
    "PERFECT_JOD",
    "PIXELS_PER_DEGREE",
    "PIXELS_PER_DEGREE_OF_FILMS",
    "Exposures",
    "Interval",
    "LightViewPairs",
    "Measure",
    "Measured",
    "bootstrap",
    "check_color_video_vdp",
    "color_video_vdp",
    "delta_e_itp",
    "displayed",
    "false_sparkle",
    "film_exposure",
    "flicker_interval",
    "flicker_ratio",
    "flicker_ratio_from_sums",
    "flicker_snr_db",
    "flicker_sums",
    "hdr_flip",
    "hdr_flip_exposures",
    "ldr_flip",
    "mean_interval",
    "pair_set",
    "snr_db",
    "snr_from_sums",
    "snr_gain_interval",
    "snr_interval",
    "snr_sums",
    "srgb_encode",
    "structural_similarity",
    "tonemapped_error",
]
