"""Files beside a stack that other programs take in: lists of its files in their words."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from mipbake.base.names import known_name
from mipbake.source.layout import INVERTED, FileLayout
from mipbake.stack.map_files import MapFile

FORMAT = "png"
"""Container of the files that sidecars list."""

_MOST_CHANNELS = 16
"""Channels of a texture set of NVIDIA's SDK at most (its README, "Introduction")."""

_LABELS: Mapping[str, tuple[str, int]] = {
    "base_color": ("Albedo", 3),
    "normal": ("Normal", 3),
    "roughness": ("Roughness", 1),
    "metallic": ("Metalness", 1),
    "occlusion": ("Occlusion", 1),
    "height": ("Displacement", 1),
    "emissive": ("Emissive", 3),
    "opacity": ("AlphaMask", 1),
}
"""Map to its semantic label and the channels that the label needs (the SDK's docs/Manifest.md, "Semantic labels")."""


@dataclass(frozen=True)
class Sidecar:
    """A file beside a stack.

    Args:
        name: of the file. content: its text.
        left_out: maps that are not in it, and why, in sentences.
    """

    name: str
    content: str
    left_out: tuple[str, ...] = ()


def neural_compression(files: Sequence[MapFile], tile: int = 0) -> Sidecar:
    """The manifest that `ntc-cli --loadManifest` of NVIDIA's RTX Neural Texture Compression takes, of files of one
    output in PNG, and a UDIM tile (0: none). The maps that shade come first, and what would be more than 16 channels is
    left out."""
    name = f"{_NAME}.{tile}.json" if tile else f"{_NAME}.json"
    entries: list[dict[str, Any]] = []
    left_out: list[str] = []
    channels = 0
    for file in sorted(files, key=lambda each: not each.layout.shades):
        layout = file.layout
        if channels + len(layout.channels) > _MOST_CHANNELS:
            left_out.append(
                f"the file {layout.name} is not in {name}: a texture set of NVIDIA's compression has at most "
                f"{_MOST_CHANNELS} channels"
            )
            continue
        channels += len(layout.channels)
        about = {"name": layout.name, "isSRGB": file.container.srgb(layout), "semantics": _semantics(layout)}
        for level, path in enumerate(file.container.files(layout, len(file.levels))):
            entries.append({"fileName": path, **about, "mipLevel": level})
    return Sidecar(name, json.dumps({"textures": entries}, indent=2) + "\n", tuple(left_out))


_NAME = "ntc"
SIDECARS = {_NAME: neural_compression}
"""Name of a sidecar to what makes it of the files of an output in PNG."""


def sidecar_named(name: str, files: Sequence[MapFile], tile: int = 0) -> Sidecar:
    """The sidecar of that name, of a stack with that UDIM number; UsageError with the list when there is none."""
    return SIDECARS[check_sidecar(name)](files, tile)


def check_sidecar(name: str) -> str:
    """The name of the sidecar that is meant; UsageError where there is none of that name."""
    return known_name("sidecar", name, SIDECARS)


def _semantics(layout: FileLayout) -> dict[str, str]:
    """Labels of the maps in a file that has all channels of them side by side: label to letters of channels."""
    found = {}
    letters = iter("RGBA")
    for name, group in groupby(layout.channels, key=lambda channel: channel.map):
        channels = list(group)
        place = "".join(next(letters) for _ in channels)
        label, count = _LABELS.get(name, ("", 0))
        if len(channels) == count and [channel.index for channel in channels] == list(range(count)):
            inverted = name == "roughness" and channels[0].encoding == INVERTED
            found["Glossiness" if inverted else label] = place
    return found
