"""What a container is: a way to write the levels of a file and to read them back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.source.images.blocks import StoredLevel, Weigh
from mipbake.source.images.file_facts import FileInfo
from mipbake.source.images.quantise import dequantised
from mipbake.source.layout import ENCODINGS, FileLayout

Texels: TypeAlias = Sequence[NDArray[np.generic]]
"""What a container stores of every level of a file, (H_L, W_L, channels), finest first."""

Sizes: TypeAlias = Sequence[tuple[int, int]]
"""(height, width) of every level."""

Band: TypeAlias = tuple[int, slice, NDArray[np.generic]]
"""A level, some rows of it, and their texels."""


class Container(ABC):
    """A way to write the levels of a file of a map, or of channels of several. Containers are stateless.

    Attributes:
        name: what users call it, and how names of its files end. texels: what they call the texels.
        summary: one line for help texts.
        encodings: of `mipbake.source.layout`, that it can hold.
        exact: whether quantised texels come back as they were, or compressed.
        complete: whether files always hold every level down to 1 x 1.
        signature: how its files begin, by which `info` is found for them; empty: OpenImageIO reads them.
    """

    name: str
    texels: str
    summary: str
    encodings: frozenset[str] = ENCODINGS
    exact = True
    complete = False
    signature = b""

    @property
    @abstractmethod
    def finer(self) -> str | None:
        """What users are advised to pass to `--format` where the files cost too much; None: nothing is more precise."""

    @abstractmethod
    def precision(self, layout: FileLayout) -> str:
        """What a texel of a file is stored as, for stack.json."""

    @abstractmethod
    def srgb(self, layout: FileLayout) -> bool:
        """Whether the colours of a file are stored sRGB-encoded."""

    def files(self, layout: FileLayout, levels: int) -> list[str]:
        """Names of the files that so many levels take: one for all of them."""
        del levels
        return [f"{layout.name}.{self.name}"]

    @abstractmethod
    def quantise(self, values: NDArray[np.float64], layout: FileLayout) -> NDArray[np.generic]:
        """(H, W, C) file values to texels, correctly rounded; UsageError for a value beyond their range."""

    def dequantise(self, texels: NDArray[np.generic]) -> NDArray[np.floating]:
        """Inverse of quantise, to file values."""
        return dequantised(texels)

    @abstractmethod
    def write(
        self, folder: Path, layout: FileLayout, levels: Texels, wrap: tuple[str, str], about: str, weigh: Weigh | None
    ) -> None:
        """Writes quantised levels, and `about`, JSON that tells how they were made, where there is a place for it.
        OutputError when that fails; containers that compress compare what was written, and choose blocks by what
        `weigh` says that errors of their texels count.
        """

    @abstractmethod
    def read(self, folder: Path, layout: FileLayout, sizes: Sizes) -> Sequence[NDArray[np.generic] | StoredLevel]:
        """Reads what write wrote: a level of (H_L, W_L, C) for each size. InputError when that fails."""

    def bands(self, folder: Path, layout: FileLayout, sizes: Sizes) -> Iterator[Band]:
        """The same, some rows at a time where the container can: to be compared with what is in memory anyway."""
        levels: Sequence[NDArray[np.generic] | StoredLevel] = self.read(folder, layout, sizes)
        return ((index, slice(0, level.shape[0]), level[...]) for index, level in enumerate(levels))

    @abstractmethod
    def info(self, path: Path) -> FileInfo:
        """What is in a file of this kind, whoever wrote it, with no texels decoded. InputError when it is broken."""
