"""The colour spaces of MaterialX documents, by the names under which they are decoded."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.base.colour import LINEAR, SRGB, canonical_colour_space
from mipbake.base.errors import UsageError
from mipbake.source.images.colours import RAW, spelt_space
from mipbake.source.mtlx.trace import Texture
from mipbake.source.options import COLOUR_ROLES
from mipbake.source.sources import Log

_NEARLY_SRGB = ("g22_rec709", "g18_rec709", "gamma22", "gamma18", "gamma24", "rec709_display")
_INTEGER_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga")


def colour_space_of(textures: Mapping[str, Texture], log: Log) -> str | None:
    """The colour space of the colours among textures by role, as `LoadOptions` takes it; None leaves it to the type of
    the file."""
    spaces: dict[str, str | None] = {}
    for role in COLOUR_ROLES:
        texture = textures.get(role)
        if texture is None:
            continue
        named, label = texture.colour_space, texture.path.name
        spaces[role] = None if named is None else decoding(named)
        if named is None:
            log.notes.append(f"{label}: the document names no colour space, its type decides")
        elif named.lower() in _NEARLY_SRGB:
            log.warnings.append(f"{label}: {named} is decoded as sRGB, which is close to it")
        elif spaces[role] is None:
            log.warnings.append(f"{label}: the colour space {named} is not known, the file's type decides")
        elif texture.inherited and spaces[role] == LINEAR and texture.path.suffix.lower() in _INTEGER_SUFFIXES:
            log.warnings.append(
                f"{label}: is linear by the document's colour space {named}, which its file input does not change; "
                'if it is sRGB, say colorspace="srgb_texture" there'
            )
    chosen = next(iter(spaces.values()), None)
    if len(set(spaces.values())) > 1:
        log.warnings.append(
            f"base colour and emissive are in different colour spaces: both are decoded as "
            f"{chosen or 'their types say'}"
        )
    return chosen


def decoding(name: str) -> str | None:
    """The name under which decoding knows a colour space; None where it does not."""
    lowered = name.strip().lower()
    if lowered.removesuffix("_scene") in _NEARLY_SRGB:
        return SRGB
    space = RAW if lowered in ("none", "data") else spelt_space(lowered.removesuffix("_scene"))
    if space is None:
        try:
            return canonical_colour_space(name)
        except UsageError:
            return None
    return LINEAR if space == RAW else f"linear {space}" if space in ("ACEScg", "ACES2065-1") else space
