"""The list of containers that maps are written to and read from; a new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mipbake.base.names import known_name
from mipbake.source.images.blocks import Weigh
from mipbake.source.images.file_facts import FileInfo
from mipbake.source.images.read_back import Band
from mipbake.source.layout import FileLayout
from mipbake.stack.gpu_files import GPU_CONTAINERS, GpuFile
from mipbake.stack.mip_files import MipExr, MipPng, MipTx

DEFAULT_FORMAT = "exr"


class Level(Protocol):
    """Texels of a level, which may be decoded when they are read.

    Attributes:
        shape: (H, W, C).
    """

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, at: Any, /) -> NDArray[np.generic]:
        """The texels of an index of an array."""


class Container(Protocol):
    """A way to write the levels of a file of a map, or of channels of several. Implementations are stateless.

    Attributes:
        name: what users call it. texels: what they call the texels. summary: one line for help texts.
        encodings: of `mipbake.source.layout`, that it can hold.
        exact: whether quantised texels come back as they were, or compressed.
        complete: whether files always hold every level down to 1 x 1.
        signature: how its files begin, by which `info` is found for them; empty: OpenImageIO reads them.
    """

    name: str
    texels: str
    summary: str
    encodings: frozenset[str]
    exact: bool
    complete: bool
    signature: bytes

    @property
    def finer(self) -> str | None:
        """What users are advised to pass to `--format` where the files cost too much; None: nothing is more precise."""

    def precision(self, layout: FileLayout) -> str:
        """What a texel of a file is stored as, for stack.json."""

    def srgb(self, layout: FileLayout) -> bool:
        """Whether the colours of a file are stored sRGB-encoded."""

    def files(self, layout: FileLayout, levels: int) -> list[str]:
        """Names of the files that so many levels take."""

    def quantise(self, values: NDArray[np.float64], layout: FileLayout) -> NDArray[np.generic]:
        """(H, W, C) file values to texels, correctly rounded; UsageError for a value beyond their range."""

    def dequantise(self, texels: NDArray[np.generic]) -> NDArray[np.floating]:
        """Inverse of quantise, to file values."""

    def write(
        self,
        folder: Path,
        layout: FileLayout,
        levels: Sequence[NDArray[np.generic]],
        wrap: tuple[str, str],
        about: str,
        weigh: Weigh | None = None,
    ) -> None:
        """Writes quantised levels, each (H_L, W_L, C), finest first, and `about`, JSON that tells how they were made,
        where there is a place for it. OutputError when that fails; containers that compress compare what was written,
        and choose blocks by what `weigh` says that errors of their texels count.
        """

    def read(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> Sequence[Level]:
        """Reads what write wrote: a level of (H_L, W_L, C) for each (height, width). InputError when that fails."""

    def bands(self, folder: Path, layout: FileLayout, sizes: Sequence[tuple[int, int]]) -> Iterator[Band]:
        """The same, some rows at a time where the container can: to be compared with what is in memory anyway."""

    def info(self, path: Path) -> FileInfo:
        """What is in a file of this kind, whoever wrote it, with no texels decoded. InputError when it is broken."""


_ALL: tuple[Container, ...] = (
    *(MipExr(texels) for texels in ("half", "float")),
    *(MipTx(texels) for texels in ("half", "float", "16", "8")),
    *(GpuFile(container, texels) for container in GPU_CONTAINERS for texels in container.texels),
    *(MipPng(texels) for texels in ("8", "16")),
)

FORMATS: Mapping[str, Mapping[str, Container]] = {
    name: {each.texels: each for each in _ALL if each.name == name} for name in dict.fromkeys(c.name for c in _ALL)
}
"""Containers by name and texels, the default texels first."""

IMAGE_FORMATS: Mapping[str, Container] = {c.name: c for c in (MipExr(mipmapped=False), MipPng(numbered=False))}
"""Containers for maps of one level, whose files have no number in their names."""


def format_named(name: str) -> Container:
    """The container that `FORMAT` or `FORMAT:TEXELS` names; UsageError with the list when there is none."""
    format, colon, _ = name.partition(":")
    known = FORMATS[known_name("format", format, FORMATS)]
    by_name = {f"{each.name}:{texels}": each for texels, each in known.items()}
    return by_name[known_name("format", name, by_name)] if colon else next(iter(known.values()))
