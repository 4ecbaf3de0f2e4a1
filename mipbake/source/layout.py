"""How a MIP stack lies in files: which map holds which stored channels, and what a value in a file means.

A *file value* is what a map's texel holds, as a real number: 0 to 1 in an 8-bit file (an integer over 255), the
number itself in a float file. An *encoding* says, channel by channel, how it follows from the stored channel.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.base import disk
from mipbake.base.errors import InputError
from mipbake.base.srgb import linear_to_srgb, srgb_to_linear
from mipbake.source.options import COLOUR_ROLES

MANIFEST = "stack.json"
"""The file of a stack's folder that declares everything about it; `manifest_name` where tiles lie in one folder."""

SCHEMA = "mipbake-stack"

PROJECT = "mipbake.toml"
"""The file that says how a library is baked."""

MATERIAL_MANIFEST = "material.json"
"""The file of a converted material's folder that declares everything about it."""

MATERIAL_SCHEMA = "mipbake-material"

COLOUR, UNIT, SIGNED, LOG = material.COLOUR, material.UNIT, material.SIGNED, material.LOG
INVERTED, FLIPPED = "inverted", "flipped"
"""Encodings. `colour`: linear Rec.709, which integer containers store sRGB-encoded; `unit`: the value itself;
`inverted`: 1 - x, gloss of a roughness; `signed`: (x + 1) / 2 of a value from -1 to 1; `flipped`: (1 - x) / 2, green of
a DirectX normal map; `log`: the value itself, a logarithm that only float containers hold."""

ENCODINGS = frozenset({COLOUR, UNIT, INVERTED, SIGNED, FLIPPED, LOG})
"""All encodings."""


def manifest_name(tile: int) -> str:
    """The file that declares everything about the stack of a UDIM tile, or, for 0, about a stack that is not a tile."""
    return f"stack.{tile}.json" if tile else MANIFEST


def is_manifest(name: str) -> bool:
    """Whether a file of that name declares a stack."""
    return re.fullmatch(r"stack(\.1\d{3})?\.json", name) is not None


def manifests(folder: Path) -> list[Path]:
    """The files of a folder that declare stacks, by their names; none where it cannot be listed."""
    try:
        return [p for p in disk.entries(folder) if is_manifest(p.name)]
    except InputError:
        return []


def tiles_in(folder: Path) -> set[int]:
    """The UDIM tiles whose stacks a folder holds, by the names of the files that declare them."""
    return {int(file.name.split(".")[1]) for file in manifests(folder) if file.name != MANIFEST}


@dataclass(frozen=True)
class MapLayout:
    """One map of a stack.

    Args:
        name: the stem of its files.
        channels: its slice of the stored channels; of a map that does not shade, all of them.
        encodings: encoding of each of its channels.
        meanings: what each of its channels holds, in words.
        shades: whether the material model reads it.
    """

    name: str
    channels: slice
    encodings: tuple[str, ...]
    meanings: tuple[str, ...]
    shades: bool = True

    @property
    def alone(self) -> FileLayout:
        """A file of this map and nothing else."""
        channels = zip(self.encodings, self.meanings, strict=True)
        return FileLayout(self.name, tuple(FileChannel(self.name, i, *c) for i, c in enumerate(channels)), self.shades)


@dataclass(frozen=True)
class FileChannel:
    """One channel of a file.

    Args:
        map: name of the map that it belongs to; empty for a constant that fills the place.
        index: of the channel in that map.
        encoding: how the file holds it.
        meaning: what it holds, in words.
    """

    map: str
    index: int
    encoding: str
    meaning: str


@dataclass(frozen=True)
class FileLayout:
    """A file of a stack: channels of one map or of several.

    Args:
        name: the stem of its files.
        channels: in the order of the file, one to four.
        shades: whether the material model reads any of it.
    """

    name: str
    channels: tuple[FileChannel, ...]
    shades: bool = True

    @property
    def encodings(self) -> tuple[str, ...]:
        """Encoding of each channel."""
        return tuple(c.encoding for c in self.channels)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels in a file."""
        return ("Y",) if len(self.channels) == 1 else ("R", "G", "B", "A")[: len(self.channels)]

    @property
    def is_colour(self) -> bool:
        """Whether the file is a colour image, which integer containers store sRGB-encoded, except for an alpha
        channel."""
        return self.channels[0].encoding == COLOUR


def _layout(model: material.MaterialModel, stem: str) -> MapLayout:
    """A file of a model, which holds one of its maps, or neighbouring ones."""
    held = model.files[stem]
    return MapLayout(
        stem,
        slice(model.maps[held[0].name].start, model.maps[held[-1].name].stop),
        tuple(each.facts.encoding for each in held for _ in each.meanings),
        tuple(meaning for each in held for meaning in each.meanings),
    )


LAYOUTS: Mapping[str, tuple[MapLayout, ...]] = {
    name: tuple(_layout(model, stem) for stem in model.files) for name, model in material.MODELS.items()
}
"""The maps of each material model as files hold them; together they hold every stored channel once."""


def channels_of(model: str, name: str) -> slice:
    """The stored channels of a map of a material model; KeyError where it has none of that name."""
    return {layout.name: layout.channels for layout in LAYOUTS[model]}[name]


def extra_layout(role: str, channels: int) -> MapLayout:
    """The layout of a map that does not shade, of that many channels."""
    encoding = COLOUR if role in COLOUR_ROLES else UNIT
    letters = tuple(f"{role}, {c}" for c in "RGBA"[:channels])
    meanings = {1: (role,), 3: material.rgb(role)}.get(channels, letters)
    return MapLayout(role, slice(0, channels), (encoding,) * channels, meanings, shades=False)


def to_file(texels: NDArray[np.floating], encodings: Sequence[str], srgb: bool) -> NDArray[np.float64]:
    """(..., C) values of channels to file values; `srgb` where the container stores colours sRGB-encoded."""
    values = texels.astype(np.float64)
    for channel, encoding in enumerate(encodings):
        value = values[..., channel]
        if encoding == SIGNED:
            values[..., channel] = (value + 1) / 2
        elif encoding == FLIPPED:
            values[..., channel] = (1 - value) / 2
        elif encoding == INVERTED:
            values[..., channel] = 1 - value
        elif encoding == COLOUR and srgb:
            values[..., channel] = linear_to_srgb(value)
    return values


def from_file(values: NDArray[np.floating], encodings: Sequence[str], srgb: bool) -> NDArray[np.float32]:
    """Inverse of to_file: (..., C) file values to float32 values of channels."""
    texels = values.astype(np.float64)
    for channel, encoding in enumerate(encodings):
        value = texels[..., channel]
        if encoding == SIGNED:
            texels[..., channel] = value * 2 - 1
        elif encoding == FLIPPED:
            texels[..., channel] = 1 - value * 2
        elif encoding == INVERTED:
            texels[..., channel] = 1 - value
        elif encoding == COLOUR and srgb:
            texels[..., channel] = srgb_to_linear(value)
    return texels.astype(np.float32)
