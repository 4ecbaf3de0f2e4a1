"""The colour spaces of MaterialX documents, by the names under which they are decoded."""

from __future__ import annotations

from collections.abc import Mapping

from mipbake.base.colour import LINEAR, SRGB, canonical_colour_space
from mipbake.base.errors import UsageError
from mipbake.source.mtlx.trace import Texture
from mipbake.source.options import COLOUR_ROLES
from mipbake.source.sources import Log

_SPACES: Mapping[str, str] = {
    **dict.fromkeys(("srgb_texture", "srgb_rec709", "srgb", "utility - srgb - texture"), SRGB),
    **dict.fromkeys(("lin_rec709", "lin_srgb", "raw", "none", "data", "linear", "non-color", "utility - raw"), LINEAR),
    **dict.fromkeys(("acescg", "lin_ap1", "aces - acescg"), "linear ACEScg"),
    **dict.fromkeys(("aces2065-1", "lin_ap0", "aces - aces2065-1"), "linear ACES2065-1"),
    **dict.fromkeys(("srgb_displayp3", "srgb_p3d65"), "Display P3"),
    **dict.fromkeys(("lin_displayp3", "lin_p3d65"), "linear Display P3"),
    "lin_rec2020": "linear ITU-R BT.2020",
    **dict.fromkeys(("adobergb", "g22_adobergb"), "Adobe RGB (1998)"),
    "lin_adobergb": "linear Adobe RGB (1998)",
}
"""Colour spaces of MaterialX and of the Color Interop Forum (without its _scene) to names that decoding knows."""

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
    lowered = name.strip().lower().removesuffix("_scene")
    if lowered in _SPACES:
        return _SPACES[lowered]
    if lowered in _NEARLY_SRGB:
        return SRGB
    try:
        return canonical_colour_space(name)
    except UsageError:
        return None
