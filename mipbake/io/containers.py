"""The containers that a MIP stack can be written in: one file each, one list."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import UsageError
from mipbake.io.layout import MapLayout
from mipbake.io.mip_exr import MipExr
from mipbake.io.mip_png import MipPng

DEFAULT_FORMAT = "exr"


class Container(Protocol):
    """A way to write the levels of one map. Implementations are stateless."""

    @property
    def name(self) -> str:
        """What users call it."""

    @property
    def summary(self) -> str:
        """One line for help texts."""

    @property
    def precision(self) -> str:
        """What a texel's channel is stored as, for stack.json."""

    @property
    def srgb(self) -> bool:
        """Whether colours are stored sRGB-encoded."""

    @property
    def encodings(self) -> frozenset[str]:
        """The encodings of `mipbake.io.layout` that it can hold."""

    def files(self, layout: MapLayout, levels: int) -> list[str]:
        """Names of the files that a map of that many levels takes."""

    def quantise(self, values: NDArray[np.float64], layout: MapLayout) -> NDArray[np.generic]:
        """(H, W, C) file values to what a texel stores, correctly rounded; UsageError for a value beyond its range."""

    def dequantise(self, texels: NDArray[np.generic]) -> NDArray[np.floating]:
        """Inverse of quantise, to file values."""

    def write(
        self, folder: Path, layout: MapLayout, levels: Sequence[NDArray[np.generic]], wrap: tuple[str, str]
    ) -> None:
        """Writes quantised levels, each (H_L, W_L, C), finest first. OutputError when that fails."""

    def read(self, folder: Path, layout: MapLayout, sizes: Sequence[tuple[int, int]]) -> list[NDArray[np.generic]]:
        """Reads what write wrote: a level of (H_L, W_L, C) for each (height, width). InputError when that fails."""


FORMATS: Mapping[str, Container] = {c.name: c for c in (MipExr(), MipPng())}


IMAGE_FORMATS: Mapping[str, Container] = {c.name: c for c in (MipExr(mipmapped=False), MipPng(numbered=False))}
"""The same for maps of one level, whose files have no number in their names."""


def format_named(name: str) -> Container:
    """The container of that name; UsageError with the list of names when there is none."""
    if name not in FORMATS:
        raise UsageError(f"unknown format {name!r}: expected one of {', '.join(FORMATS)}")
    return FORMATS[name]
