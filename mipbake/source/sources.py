"""What was found of a texture set before anything is decoded: the source of every map, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour import LINEAR
from mipbake.material import GLTF_MODELS, MODELS
from mipbake.source.images.image import Header, Image
from mipbake.source.options import COLOUR_ROLES, STRAIGHT

DATA = "data"
"""Encoding of maps whose values are not colours: stored linearly."""


@dataclass(frozen=True)
class MapSource:
    """Where the values of one role come from.

    Args:
        role: see `mipbake.source.options.ROLES`.
        path: the file; None for a constant or for an array given from Python.
        channels: letters of the file's channels that are taken ("RGB", "G", "Y" for grey); empty without a file.
        width, height: size of the source in texels; 1 x 1 for a constant.
        depth: stored type of the file ("uint8", "uint16", "half", "float"); "float" without a file.
        encoding: colour space of the source for colours, "data" for everything else.
        inverted: the source stores one minus the value.
        reason: why this source fills the role.
        constant: the value, in linear units, where there is no file.
        channels_named: whether the file's name or the user says which channels; else they follow from the role.
        convention: "opengl" or "directx" where a normal map's name says so.
        converted: whether the values of the role are made of the values of this file and of another file. A metallic is
            made of the specular colours, which are what is in this file. What is written has the role's name.
        orientation: how the file says that its image is turned; vectors are turned, too. See
            `mipbake.source.images.image`.
        layer: of the file, which the role takes; see `mipbake.source.images.image`.
        alpha: "premultiplied" where its colours are to be divided by the alpha beside them, else "straight".
        metadata: whether what the file says counts; see `LoadOptions`.
        sha256: of the file, in hexadecimal; empty until it has been read.
        notes: what was found while reading, in sentences.
    """

    role: str
    path: Path | None
    channels: str
    width: int
    height: int
    depth: str
    encoding: str
    inverted: bool
    reason: str
    constant: tuple[float, ...] | None = None
    channels_named: bool = False
    convention: str | None = None
    converted: bool = False
    orientation: int = 1
    layer: tuple[int, str] = (0, "")
    alpha: str = STRAIGHT
    metadata: bool = True
    sha256: str = ""
    notes: tuple[str, ...] = ()

    @classmethod
    def of_file(
        cls, role: str, header: Header, channels: str, encoding: str, inverted: bool, reason: str, **others: Any
    ) -> MapSource:
        """The source of a role whose values come from the file of a header; `others`: further fields."""
        about = (header.width, header.height, header.depth, encoding, inverted, reason)
        layer = (header.declared.part, header.declared.layer)
        return cls(role, header.path, channels, *about, layer=layer, **others)

    @classmethod
    def made(cls, role: str, width: int, height: int, reason: str) -> MapSource:
        """The source of a role whose values are in no file, and why it fills the role."""
        encoding = LINEAR if role in COLOUR_ROLES else DATA
        return cls(role, None, "", width, height, "float", encoding, False, reason)

    @property
    def applied(self) -> tuple[object, ...]:
        """What of the file's own words decides its values, beside its bytes; for comparing sources."""
        return (self.orientation, *self.layer, self.alpha, self.metadata)


@dataclass(frozen=True)
class NormalConvention:
    """Convention of the source's normal map: "opengl" (green up) or "directx" (green down).

    `decided_by` is "option", "document" (glTF and MaterialX say it), "name", "pixels" (the integrability test),
    "assumed" (the test could not tell) or "flat" (there is nothing to tell); `confidence` is the confidence of the
    test, and 1 where no test was needed.
    """

    name: str
    decided_by: str
    confidence: float


DECISIONS = {
    "option": "as the option says",
    "document": "as the document says",
    "name": "as the file's name says",
    "pixels": "as the curl of its slopes shows",
    "assumed": "which is assumed",
    "flat": "which is assumed, because all normals are the same",
}
"""`NormalConvention.decided_by` to words that follow the name of a convention."""


@dataclass(frozen=True)
class IgnoredFile:
    """A file that fills no role, and why."""

    path: Path
    reason: str


@dataclass(frozen=True)
class Found:
    """What was found of a texture set: names and headers, nothing decoded. `mipbake.source.texture_set.read` makes a
    `TextureSet` of it, which says the same of itself in `TextureSet.found`, in fields of the same names.

    Args:
        model: the material model that the maps fill.
        maps: role to source, in the order of `ROLES`; always holds base_color, normal, roughness and metallic.
        normal_convention: of the normal map, and how that was decided.
    """

    name: str
    width: int
    height: int
    model: str
    maps: Mapping[str, MapSource]
    normal_convention: NormalConvention
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    ignored: tuple[IgnoredFile, ...]

    @property
    def hashes(self) -> dict[str, str]:
        """Source file name to SHA-256, which is empty before the file is read."""
        return {source.path.name: source.sha256 for source in self.maps.values() if source.path}


def source_model(anisotropic: bool) -> str:
    """The material model of sources that have an anisotropy map, or that have none."""
    return next(name for name in GLTF_MODELS if MODELS[name].anisotropic == anisotropic)


@dataclass
class Log:
    """Sentences that collect on the way."""

    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def taken(source: MapSource, image: Image) -> NDArray[np.generic]:
    """The channels of a file's image that a source takes, (H, W, len(channels)), as stored."""
    index = [image.header.alpha if c == "A" else 0 if c == "Y" else "RGB".index(c) for c in source.channels]
    first, count = index[0], len(index)
    contiguous = index == list(range(first, first + count))
    return image.pixels[..., first : first + count] if contiguous else image.pixels[..., index]


def spoken(word: str) -> str:
    """A role's or a convention's name in prose."""
    return {"opengl": "OpenGL", "directx": "DirectX", "base_color": "base colour"}.get(word, word)
