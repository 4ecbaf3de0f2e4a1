"""The list of containers that maps are written to and read from; a new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.base.names import known_name
from mipbake.stack.container import Container
from mipbake.stack.gpu_files import DdsFile, Ktx2File
from mipbake.stack.mip_files import MipExr, MipPng, MipTx

DEFAULT_FORMAT = "exr"

_ALL: tuple[Container, ...] = (
    *(MipExr(texels) for texels in ("half", "float")),
    *(MipTx(texels) for texels in ("half", "float", "16", "8")),
    *(kind(texels) for kind in (Ktx2File, DdsFile) for texels in kind.choices),
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
