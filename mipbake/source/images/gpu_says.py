"""What KTX 2 and DDS files say of their images: see `mipbake.source.images.declared`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from mipbake.base import disk
from mipbake.source.images import dds, ktx2
from mipbake.source.images.declared import Declared
from mipbake.source.images.declared_colour import Colour
from mipbake.source.options import CUSTOM, PREMULTIPLIED, STRAIGHT

if TYPE_CHECKING:
    import OpenImageIO

_TRANSFERS = {
    **{0: "", 1: "linear", 2: "sRGB", 3: "BT.709", 4: "SMPTE 170M", 5: "S-Log", 6: "S-Log 2", 7: "BT.1886", 8: "HLG"},
    **{9: "HLG", 10: "PQ", 11: "PQ", 12: "DCI-P3", 15: "SMPTE 240M", 16: "ACEScc", 17: "ACEScct", 18: "gamma 2.2"},
}
_PRIMARIES = {
    **{0: "", 1: "Rec.709", 2: "BT.601 (EBU)", 3: "BT.601 (SMPTE)", 4: "Rec.2020", 5: "CIE XYZ", 6: "AP0", 7: "AP1"},
    **{8: "NTSC 1953", 9: "PAL", 10: "P3", 11: "Adobe RGB"},
}
"""Numbers of Khronos's data formats 1.3 to words of `mipbake.source.images.declared_colour`; 0 is unspecified."""

_ORIENTATIONS = {"rd": 1, "ld": 2, "lu": 3, "ru": 4}


def ktx2_said(found: ktx2.Outline, channels: int, alpha: int, names: str) -> tuple[Declared, int, int]:
    """What a KTX 2 file says of its image, how many channels the image has, and the index of alpha in it.

    Args:
        found: from `ktx2.outline`.
        channels: that its texels have. alpha: which of them is alpha; -1: none.
        names: letter of KTXswizzle to a letter of Declared's, in pairs, where decoded texels have lost channels.
    """
    transfer, primaries = (
        words.get(number, f"code {number}")
        for words, number in ((_TRANSFERS, found.transfer), (_PRIMARIES, found.primaries))
    )
    warnings: list[str] = []
    turn = _text(found, "KTXorientation")
    if turn and turn[:2] not in _ORIENTATIONS:
        warnings.append(f"its KTXorientation is {turn!r}, expected one of {', '.join(_ORIENTATIONS)}: it is left out")
    letters, alpha = _swizzle(_text(found, "KTXswizzle"), channels, alpha, names, warnings)
    said = Declared(
        orientation=_ORIENTATIONS.get(turn[:2], 1),
        texels_alone=True,
        swizzle=letters,
        alpha=PREMULTIPLIED if found.premultiplied and alpha >= 0 else STRAIGHT,
        colour=Colour(transfer, primaries, by="its data format descriptor"),
        notes=(f"its channels are {letters}, as its KTXswizzle says",) if letters else (),
        warnings=tuple(warnings),
    )
    return said, len(letters) or channels, alpha


def _text(found: ktx2.Outline, key: str) -> str:
    return found.values.get(key, b"").rstrip(b"\0").decode("ascii", "replace")[:16]


def _swizzle(told: str, channels: int, alpha: int, names: str, warnings: list[str]) -> tuple[str, int]:
    """The channels of an image by a KTXswizzle, in letters, none where they are as stored, and the index of alpha.

    Three equal colours are one, and an alpha of 1 is none. Graphics cards find 0 in colours that are not stored, and 1
    in an alpha.
    """
    if not told:
        return "", alpha
    if not re.fullmatch("[rgba01]{4}", told):
        warnings.append(f"its KTXswizzle is {told!r}, expected four letters of rgba01: it is left out")
        return "", alpha
    stored = "rgba"[:channels]
    there = told.translate(str.maketrans(names[::2], names[1::2]))
    there = "".join(c if c in f"{stored}01" else "1" if c == "a" else "0" for c in there)
    colours, last = there[:3], there[3]
    grey = len(set(colours)) == 1
    shown = colours[0] if grey else colours
    if last != "1":
        shown, alpha = shown + last, len(shown)
    else:
        shown, alpha = shown.rstrip("0") or shown, -1  # vectors of two channels have no blue
    return ("", alpha) if shown == stored else (shown, alpha)


def dds_said(path: Path, spec: OpenImageIO.ImageSpec) -> Declared:
    """What a DDS file says that OpenImageIO reads."""
    with disk.opened(path) as file:
        head = dds.header(file.read(dds.START))
    return Declared() if head is None else of_header(head, spec.nchannels, spec.alpha_channel)


def of_header(head: dds.Header, channels: int, alpha: int) -> Declared:
    """What a header of DDS says of an image of so many channels."""
    if alpha < 0:
        return Declared()
    if head.alpha == dds.OPAQUE:
        return Declared(
            channels=_without(channels, alpha),
            notes=("its alpha is left out, because its header says that the image is opaque",),
        )
    if head.alpha == dds.CUSTOM:
        return Declared(alpha=CUSTOM, notes=("its alpha is no opacity, as its header says",))
    return Declared(alpha=PREMULTIPLIED if head.alpha == dds.PREMULTIPLIED else STRAIGHT)


def _without(channels: int, alpha: int) -> tuple[int, ...]:
    return tuple(index for index in range(channels) if index != alpha)
