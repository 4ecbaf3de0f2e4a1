"""Colours as files declare them: a transfer function and primaries, by whichever means a format has, or a name.

Names are also found at the ends of file names: `wood_ACEScg.exr`, `wood_BaseColor_Utility - sRGB - Texture.exr`. The
spellings are those that artists' programs write: the colour spaces of OpenColorIO's configurations for ACES (1.2, CG
and Studio), of MaterialX, of Blender, and their short forms.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

from mipbake.base.colour import LINEAR, SRGB

_SPACES = {
    ("sRGB", "Rec.709"): SRGB,
    ("linear", "Rec.709"): LINEAR,
    ("BT.709", "Rec.709"): "ITU-R BT.709",
    ("sRGB", "P3"): "Display P3",
    ("linear", "P3"): "linear Display P3",
    ("gamma 2.2", "Adobe RGB"): "Adobe RGB (1998)",
    ("linear", "Adobe RGB"): "linear Adobe RGB (1998)",
    ("BT.709", "Rec.2020"): "ITU-R BT.2020",
    ("linear", "Rec.2020"): "linear ITU-R BT.2020",
    ("linear", "AP1"): "ACEScg",
    ("linear", "AP0"): "ACES2065-1",
}
"""Transfer function and primaries to a name that `mipbake.base.colour.canonical_colour_space` takes."""

_PRIMARIES = {1: "Rec.709", 2: "", 9: "Rec.2020", 12: "P3"}
_TRANSFERS = {1: "BT.709", 2: "", 6: "BT.709", 8: "linear", 13: "sRGB", 14: "BT.709", 15: "BT.709"}
_OTHER_TRANSFERS = {4: "gamma 2.2", 5: "gamma 2.8", 16: "PQ", 18: "HLG"}
"""Code points of ITU-T H.273; 2 is unspecified."""

CHROMATICITIES = {
    "Rec.709": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "AP1": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
    "AP0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "P3": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
    "Rec.2020": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    "Adobe RGB": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329),
}
"""x and y of red, green, blue and white: ITU-R BT.709 and BT.2020, SMPTE ST 2065-1 and EG 432-1, Adobe RGB (1998), and
S-2014-004 of the Academy."""

_SAME = 0.002
"""Chromaticities that differ by less are written with fewer digits."""


@dataclass(frozen=True)
class Colour:
    """What a file says of its colours.

    Args:
        transfer: "sRGB", "linear", "gamma 2.2", "BT.709", or any other words; empty where the file does not say.
        primaries: "Rec.709", "P3", "Adobe RGB", "Rec.2020", "AP1", "AP0", or any other words; empty the same.
        named: the colour space where the file names one, which then counts.
        by: what says it, as in "its ICC profile"; empty where nothing does.
    """

    transfer: str = ""
    primaries: str = ""
    named: str = ""
    by: str = ""

    @property
    def space(self) -> str | None:
        """The colour space; None where the file does not say how values are encoded, or where it is not known here."""
        if self.named:
            return self.named
        return _SPACES.get((self.transfer, self.primaries or "Rec.709"))

    @property
    def unknown(self) -> str:
        """What the file says, where that is no colour space that is known here; else empty."""
        if self.space is not None or (not self.transfer and self.primaries in ("", "Rec.709")):
            return ""
        said = {"transfer": self.transfer, "primaries": self.primaries}
        return ", ".join(f"{what}: {word}" for what, word in said.items() if word)


def coded(primaries: int, transfer: int, by: str) -> Colour:
    """What code points of ITU-T H.273 say."""
    other = _OTHER_TRANSFERS.get(transfer, f"code {transfer}")
    return Colour(_TRANSFERS.get(transfer, other), _PRIMARIES.get(primaries, f"code {primaries}"), by=by)


def primaries_of(values: object) -> str:
    """The primaries of eight chromaticities, red to white, as files list them; empty where there are not eight."""
    if not isinstance(values, tuple) or len(values) != 8:
        return ""
    for name, known in CHROMATICITIES.items():
        if all(abs(float(found) - wanted) < _SAME for found, wanted in zip(values, known, strict=True)):
            return name
    return " ".join(f"{float(value):.4g}" for value in values)


RAW = "raw"
"""What a name tells of values that no transform has touched. A map of colours is then read as linear Rec.709."""

_LINEAR_WORDS = ("lin", "linear", "utilitylinear", "scenelinear", "utilitylin", "scenelin")
_LINEAR_PRIMARIES = {
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
    "Display P3": "displayp3 srgbdisplayp3 srgbp3d65 srgbp3d65scene srgbp3d65display srgbencodedp3d65",
    "Adobe RGB (1998)": "adobergb adobergb1998 g22adobergb g22adobergbscene",
    RAW: "raw utilityraw noncolor noncolour noncolordata noncolourdata",
}
_MOST_WORDS = 6
# Words that capitals alone set off: `woodDiffuseACEScg`.
_GLUED = re.compile(r"(?<=[a-z0-9])(?=(?:ACEScg|ACEScct?|sRGB|AdobeRGB)[^A-Za-z0-9]*$)")
_CHUNK = re.compile(r"[A-Za-z0-9]+")


def spelt_space(name: str) -> str | None:
    """The colour space of a spelling: a name that `canonical_colour_space` takes, or `RAW`; None for others."""
    return _spaces().get("".join(_CHUNK.findall(name)).lower())


@cache
def _spaces() -> dict[str, str]:
    """Spelling, in lower case and without separators, to colour space."""
    known = [(name, word) for name, words in _LINEAR_PRIMARIES.items() for word in words.split()]
    spaces = {linear + word: name for name, word in known for linear in _LINEAR_WORDS}
    spaces |= {word: name for name, words in _SPELLINGS.items() for word in words.split()}
    return spaces


_SILENT = ("", "unknown", "data", "isdata", "auto", RAW)
_UNSPECIFIC = ("lin", "linear", "scenelinear")


def named_space(name: object, attribute: str, otherwise: Colour) -> Colour:
    """What a file says of its colours that names their space in an attribute; `otherwise` where it does not."""
    if not isinstance(name, str):
        return otherwise
    spelt, space = "".join(_CHUNK.findall(name)).lower(), spelt_space(name)
    if spelt in _SILENT or space == RAW or (spelt in _UNSPECIFIC and otherwise.primaries):
        return otherwise
    if space is None and spelt in _UNSPECIFIC:
        space = LINEAR
    by = "the file" if space else f"its {attribute}"
    return Colour(transfer="" if space else name[:40], named=space or "", by=by)


def split_colour_space(stem: str) -> tuple[str, str | None]:
    """What stands before the colour space at the end of a stem, and the colour space, as `spelt_space` has it; None
    where the stem ends in none, or is nothing else."""
    stem = _GLUED.sub("_", stem)
    chunks = list(_CHUNK.finditer(stem))
    for start in range(max(1, len(chunks) - _MOST_WORDS), len(chunks)):  # the longest spelling first
        if (space := spelt_space(stem[chunks[start].start() :])) is not None:
            return stem[: chunks[start].start()], space
    return stem, None
