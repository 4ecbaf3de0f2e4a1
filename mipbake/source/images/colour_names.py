"""Colour spaces as the names of files tell them: `wood_ACEScg.exr`, `wood_BaseColor_Utility - sRGB - Texture.exr`.

The spellings are those that artists' programs write: the colour spaces of OpenColorIO's configurations for ACES (1.2,
CG and Studio), of MaterialX, of Blender, and their short forms.
"""

from __future__ import annotations

import re
from functools import cache

from mipbake.base.colour import LINEAR, SRGB
from mipbake.source.images.declared_colour import Colour

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
    "inputgenericsrgbtexture genericsrgbtexture srgbdisplay srgbrec709display",
    LINEAR: "lin linear rawlinear",
    "ACEScg": "acescg acesacescg",
    "ACEScc": "acescc acesacescc",
    "ACEScct": "acescct acesacescct",
    "ACES2065-1": "aces20651 acesaces20651",
    "Display P3": "displayp3 srgbp3d65 srgbp3d65scene srgbp3d65display srgbencodedp3d65",
    "Adobe RGB (1998)": "adobergb adobergb1998 g22adobergb g22adobergbscene",
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


_SILENT = ("", "unknown", "data", "isdata", "auto", RAW)
_UNSPECIFIC = ("lin", "linear", "scenelinear")


def named_space(name: object, attribute: str, otherwise: Colour) -> Colour:
    """What a file says of its colours that names their space in an attribute; `otherwise` where it does not."""
    if not isinstance(name, str):
        return otherwise
    spelt = "".join(chunk[0] for chunk in _CHUNK.finditer(name)).lower()
    space = _spaces().get(spelt)
    if spelt in _SILENT or space == RAW or (spelt in _UNSPECIFIC and otherwise.primaries):
        return otherwise
    if space is None and spelt in _UNSPECIFIC:
        space = LINEAR
    by = "the file" if space else f"its {attribute}"
    return Colour(transfer="" if space else name[:40], named=space or "", by=by)


def split_colour_space(stem: str) -> tuple[str, str | None]:
    """What stands before the colour space at the end of a stem, and the colour space.

    The colour space has a name that `mipbake.base.colour.canonical_colour_space` takes, or is `RAW`. It is None where
    the stem ends in none, or is nothing else.
    """
    stem = _GLUED.sub("_", stem)
    chunks = list(_CHUNK.finditer(stem))
    for start in range(max(1, len(chunks) - _MOST_WORDS), len(chunks)):  # the longest spelling first
        space = _spaces().get("".join(chunk[0] for chunk in chunks[start:]).lower())
        if space is not None:
            return stem[: chunks[start].start()], space
    return stem, None
