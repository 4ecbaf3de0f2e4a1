"""Colours as files declare them: a transfer function and primaries, by whichever means a format has."""

from __future__ import annotations

from dataclasses import dataclass

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
        primaries = f"primaries: {self.primaries}" if self.primaries else ""
        transfer = f"transfer: {self.transfer}" if self.transfer else ""
        return ", ".join(part for part in (transfer, primaries) if part)


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
