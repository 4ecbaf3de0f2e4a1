"""ColorVideoVDP: how good a film looks beside its reference, by the authors' package cvvdp."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from mipbake.base.errors import UsageError
from mipbake.quality.metrics.cvvdp_package import cvvdp_package
from mipbake.quality.metrics.images import ImageArray, checked_display

DISPLAY = "standard_fhd"
"""The package's display whose light is assumed: 200 cd/m^2 at most, contrast 1000:1, in an office of 250 lux."""

_LEAST_SIDE = 8  # pixels; smaller pictures leave the package's pyramid fewer than two bands
_RESOLUTION = 1920, 1080  # the package wants one; the pixels per degree are given, so nothing depends on it


def check_color_video_vdp() -> None:
    """UsageError, which says what to type, where the package cvvdp is not installed."""
    cvvdp_package()


def color_video_vdp(
    candidate: ImageArray, reference: ImageArray, pixels_per_degree: float, frames_per_second: float
) -> float:
    """Quality of a displayed film beside a reference film, in JOD (just objectionable differences).

    10 is no visible difference, and one less is what three in four people prefer the reference over. Values may be
    negative. Mantiuk et al. 2024, "ColorVideoVDP: a visual difference predictor for image, video and display
    distortions", with the model data in the package. The film is shown as it is, sRGB-encoded, on the display DISPLAY;
    its pixels are as large as pixels_per_degree says. The first frame is taken to have stood still before the film
    starts. Work is done on the CPU with torch's threads, without gradients; the same films have the same quality.

    Memory, measured: about 700 + 10 frames_per_second bytes for each pixel of one frame, and 50 bytes for each pixel of
    every frame. A film of 16 frames of 240 x 160 pixels takes about 80 MB beyond the import.

    Args:
        candidate, reference: (T, H, W, 3) sRGB-encoded colours in [0, 1]; at least 2 frames of 8 x 8 pixels.
        pixels_per_degree: of visual angle, above 0: 37 is a 24-inch display of 1920 pixels seen from 0.6 m, 75 one of
            3840 pixels, 30 inches, seen from 0.75 m.
        frames_per_second: above 0.
    """
    for name, value, example in (
        ("pixels_per_degree", pixels_per_degree, "37"),
        ("frames_per_second", frames_per_second, "30"),
    ):
        if not 0 < value < math.inf:
            raise UsageError(f"{name} is {value}: expected a number above 0, for example {example}")
    p, r = checked_display(candidate, reference, np.float32)
    if r.ndim != 4 or len(r) < 2 or min(r.shape[1:3]) < _LEAST_SIDE:
        raise UsageError(
            f"the films have shape {r.shape}: expected (T, H, W, 3), at least 2 frames of {_LEAST_SIDE} pixels a side"
        )
    package = cvvdp_package()
    import torch

    data = [str(Path(str(package.__file__)).parent / "vvdp_data")]  # else the variable CVVDP_PATH could replace it
    photometry = package.vvdp_display_photometry.load(DISPLAY, data)
    metric = package.cvvdp(
        display_name=DISPLAY,
        display_photometry=photometry,
        display_geometry=package.vvdp_display_geometry(_RESOLUTION, ppd=float(pixels_per_degree)),
        config_paths=data,
        quiet=True,
        device=torch.device("cpu"),
    )
    films = (torch.from_numpy(film if film.flags.writeable else film.copy()) for film in (p, r))
    source = package.cvvdp_metric.video_source_array(
        *films, float(frames_per_second), dim_order="FHWC", display_photometry=photometry, config_paths=data
    )
    source.warning_shown = True  # it would warn of dark films, and set up the root logger of the program for that
    with torch.no_grad():
        quality, _ = metric.predict_video_source(source)
    return float(quality)
