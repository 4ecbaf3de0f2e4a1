"""An image, and its header: what reading a file gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.source.images.declared import Declared

Place: TypeAlias = "tuple[int, str]"
"""Part and layer of a file that has several."""


@dataclass(frozen=True)
class Header:
    """What is known of an image: size in texels, number of channels, the index of alpha (-1: none), stored type, and
    what the file says of it, which size and channels follow already.
    """

    path: Path
    width: int
    height: int
    channels: int
    alpha: int
    depth: str
    declared: Declared = field(default_factory=Declared)

    @property
    def colour_space(self) -> str | None:
        """The colour space that the file tells for its colours."""
        return self.declared.colour.space

    @property
    def is_integer(self) -> bool:
        """Whether values are stored as integers that stand for [0, 1]."""
        return self.depth not in ("half", "float", "double")


@dataclass(frozen=True)
class Image:
    """A file's image: pixels (H, W, C) of uint8, uint16, float16 or float32 with the colours as stored, turned and
    placed as the file says, its header, and the file's SHA-256 in hexadecimal.
    """

    pixels: NDArray[np.generic]
    header: Header
    sha256: str
