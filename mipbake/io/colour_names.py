"""Colour spaces as the names of files tell them: `wood_ACEScg.exr`, `wood_BaseColor_Utility - sRGB - Texture.exr`.

The spellings are those that artists' programs write: the colour spaces of OpenColorIO's configurations for ACES (1.2,
CG and Studio), of MaterialX, of Blender, and their short forms.
"""

from __future__ import annotations

import re
from functools import cache

from mipbake.io.colour import LINEAR, SRGB

RAW = "raw"
"""What a name tells of values that no transform has touched. A map of colours is then read as linear Rec.709."""

_LINEAR_WORDS = ("lin", "linear", "utilitylinear", "scenelinear", "utilitylin", "scenelin")
_PRIMARIES = {
    LINEAR: "srgb rec709 rec709srgb rec709scene bt709",
    "ACEScg": "ap1 ap1scene acescg acescgap1",
    "ACES2065-1": "ap0 ap0scene aces20651",
    "linear Display P3": "p3d65 p3d65scene displayp3",
    "linear ITU-R BT.2020": "rec2020 rec2020scene bt2020",
    "linear Adobe RGB (1998)": "adobergb adobergbscene",
}
_SPELLINGS = {
    SRGB: "srgb srgbtexture srgbtx srgbrec709 srgbrec709scene srgbencodedrec709srgb utilitysrgbtexture utilitysrgb "
    "inputgenericsrgbtexture genericsrgbtexture srgbdisplay",
    LINEAR: "lin linear rawlinear",
    "ACEScg": "acescg acesacescg",
    "ACEScc": "acescc acesacescc",
    "ACEScct": "acescct acesacescct",
    "ACES2065-1": "aces20651 acesaces20651",
    "Display P3": "displayp3 srgbp3d65 srgbp3d65scene srgbencodedp3d65",
    "Adobe RGB (1998)": "adobergb adobergb1998",
    RAW: "raw utilityraw noncolor noncolour noncolordata noncolourdata",
}
_MOST_WORDS = 6
# Words that capitals alone set off: `woodDiffuseACEScg`.
_GLUED = re.compile(r"(?<=[a-z0-9])(?=(?:ACEScg|ACEScct?|sRGB|AdobeRGB)[^A-Za-z0-9]*$)")
_CHUNK = re.compile(r"[A-Za-z0-9]+")


@cache
def _spaces() -> dict[str, str]:
    """Spelling, in lower case and without separators, to colour space."""
    spaces = {lin + word: name for name, words in _PRIMARIES.items() for word in words.split() for lin in _LINEAR_WORDS}
    spaces |= {word: name for name, words in _SPELLINGS.items() for word in words.split()}
    return spaces


_CHROMATICITIES = {
    LINEAR: (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "ACEScg": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
    "ACES2065-1": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "linear Display P3": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
    "linear ITU-R BT.2020": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    "linear Adobe RGB (1998)": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329),
}
"""x and y of red, green, blue and white: ITU-R BT.709 and BT.2020, SMPTE ST 2065-1 and EG 432-1, Adobe RGB (1998), and
S-2014-004 of the Academy."""

_SAME = 0.002
"""Chromaticities that differ by less are written with fewer digits."""


def told_by_file(name: object, chromaticities: object) -> str | None:
    """The colour space that an OpenEXR file tells: by its name, else linear light of the primaries that it lists.

    None where it tells none, or one that is not known.
    """
    if isinstance(name, str):
        space = _spaces().get("".join(chunk[0] for chunk in _CHUNK.finditer(name)).lower())
        return None if space == RAW else space
    if not isinstance(chromaticities, tuple) or len(chromaticities) != 8:
        return None
    for space, known in _CHROMATICITIES.items():
        if all(abs(float(found) - wanted) < _SAME for found, wanted in zip(chromaticities, known, strict=True)):
            return space
    return None


def split_colour_space(stem: str) -> tuple[str, str | None]:
    """What stands before the colour space at the end of a stem, and the colour space.

    The colour space has a name that `mipbake.io.colour.canonical_colour_space` takes, or is `RAW`. It is None where the
    stem ends in none, or is nothing else.
    """
    stem = _GLUED.sub("_", stem)
    chunks = list(_CHUNK.finditer(stem))
    for start in range(max(1, len(chunks) - _MOST_WORDS), len(chunks)):  # the longest spelling first
        space = _spaces().get("".join(chunk[0] for chunk in chunks[start:]).lower())
        if space is not None:
            return stem[: chunks[start].start()], space
    return stem, None
