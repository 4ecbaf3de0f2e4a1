"""What the scripts share: modules of the fitting examples, which are imported from here, and the command line."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parent.parent / "fitting"))

import camera
import meshes
import report
import textures

__all__ = ["camera", "meshes", "parse", "psnr", "report", "textures"]

parse = partial(report.parse, folder="stochastic")


def psnr(image: NDArray[np.float32], wanted: NDArray[np.float32]) -> float:
    """Peak signal-to-noise ratio in dB, of values whose peak is 1."""
    return float(-10 * np.log10(np.square(image - wanted, dtype=np.float64).mean()))
