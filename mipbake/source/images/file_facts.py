"""What is known of a file, whoever wrote it, without the texels themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mipbake.base.json_text import parsed


@dataclass(frozen=True)
class ImageInfo:
    """What is known of an image within a document, without a look at its pixels.

    Args:
        name: that the document gives it, else its number. mime: media type that its bytes have.
        texels, colour_space, levels: the same as in a `FileInfo`; empty for anything but KTX 2.
    """

    name: str
    mime: str
    texels: str
    colour_space: str
    levels: tuple[tuple[int, int], ...]
    bytes: int


@dataclass(frozen=True)
class FileInfo:
    """What is in a file.

    Args:
        container: what it is. texels: what a texel is stored as.
        channels: names of its channels, where the container has names.
        levels: (width, height) of every level, finest first; empty for documents.
        colour_space: of its texels, where it says one.
        about: what mipbake wrote into it about how it was made; empty in files of others.
        attributes: what else it says that matters to who samples it. images: within a document.
    """

    path: Path
    container: str
    texels: str
    channels: tuple[str, ...]
    levels: tuple[tuple[int, int], ...]
    colour_space: str
    bytes: int
    about: Mapping[str, Any] = field(default_factory=dict)
    attributes: Mapping[str, str] = field(default_factory=dict)
    images: tuple[ImageInfo, ...] = ()


def told(text: str) -> Mapping[str, Any]:
    """What a file says of how it was made, from the JSON in it; empty where there is none."""
    try:
        content = parsed(text)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def colour_space(srgb: bool) -> str:
    """What colours are called that are encoded so, or not."""
    return "sRGB" if srgb else "linear"
