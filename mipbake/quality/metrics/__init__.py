"""What is measured: light-view pair sets, error measures over them and over images, and their confidence intervals.

Measures raise UsageError for other shapes and values than they name, for a reference that is black where they need
light, and where a package that they call is not installed. Here is what code outside of this folder uses.
"""

from mipbake.quality.metrics.color_video_vdp import check_color_video_vdp, color_video_vdp
from mipbake.quality.metrics.flicker import flicker_ratio, flicker_snr_db
from mipbake.quality.metrics.flip import hdr_flip_exposures, ldr_flip
from mipbake.quality.metrics.images import (
    Measured,
    displayed,
    false_sparkle,
    film_exposure,
    srgb_encode,
    tonemapped_error,
)
from mipbake.quality.metrics.intervals import (
    Interval,
    bootstrap,
    flicker_interval,
    snr_gain_interval,
    snr_interval,
)
from mipbake.quality.metrics.pairs import PAIR_SETS, LightViewPairs, pair_set
from mipbake.quality.metrics.registry import MEASURES, PIXELS_PER_DEGREE_OF_FILMS
from mipbake.quality.metrics.snr import MAX_SNR_DB, snr_db, snr_from_sums, snr_sums

__all__ = [
    "MAX_SNR_DB",
    "MEASURES",
    "PAIR_SETS",
    "PIXELS_PER_DEGREE_OF_FILMS",
    "Interval",
    "LightViewPairs",
    "Measured",
    "bootstrap",
    "check_color_video_vdp",
    "color_video_vdp",
    "displayed",
    "false_sparkle",
    "film_exposure",
    "flicker_interval",
    "flicker_ratio",
    "flicker_snr_db",
    "hdr_flip_exposures",
    "ldr_flip",
    "pair_set",
    "snr_db",
    "snr_from_sums",
    "snr_gain_interval",
    "snr_interval",
    "snr_sums",
    "srgb_encode",
    "tonemapped_error",
]
