"""Images that OpenImageIO does not read, with what they say of themselves: AVIF, level 0 of KTX 2 textures, and of some
DDS ones."""

from __future__ import annotations

import io
import re
import struct
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.base import disk
from mipbake.base.colour import LINEAR
from mipbake.base.errors import InputError, MipbakeError, UsageError
from mipbake.base.messages import one_line
from mipbake.source.images import dds, ktx2
from mipbake.source.images.blocks import from_blocks
from mipbake.source.images.colours import Colour, coded
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuTexture
from mipbake.source.images.icc import profile_colour
from mipbake.source.images.image import Declared, Header, orientation
from mipbake.source.options import CUSTOM, PREMULTIPLIED, STRAIGHT

if TYPE_CHECKING:
    import OpenImageIO
    from PIL import ImageFile

_EXIF_ORIENTATION = 0x112
"""Number of the tag, in Exif."""

_PROPERTIES = 1 << 16
"""Bytes at the beginning that hold the properties of an image."""

_AVIF = (b"ftypavif", b"ftypavis")
START = dds.START
"""Bytes of a file that show whether it is one of these."""

_HALF_FLOATS = tuple(made.dxgi for made in GPU_FORMATS.values() if made.is_float)

_TRANSFERS = {
    **{0: "", 1: "linear", 2: "sRGB", 3: "BT.709", 4: "SMPTE 170M", 5: "S-Log", 6: "S-Log 2", 7: "BT.1886", 8: "HLG"},
    **{9: "HLG", 10: "PQ", 11: "PQ", 12: "DCI-P3", 15: "SMPTE 240M", 16: "ACEScc", 17: "ACEScct", 18: "gamma 2.2"},
}
_PRIMARIES = {
    **{0: "", 1: "Rec.709", 2: "BT.601 (EBU)", 3: "BT.601 (SMPTE)", 4: "Rec.2020", 5: "CIE XYZ", 6: "AP0", 7: "AP1"},
    **{8: "NTSC 1953", 9: "PAL", 10: "P3", 11: "Adobe RGB"},
}
"""Numbers of Khronos's data formats 1.3 to words of `mipbake.source.images.colours`; 0 is unspecified."""

_ORIENTATIONS = {"rd": 1, "ld": 2, "lu": 3, "ru": 4}

_RED_SLICE, _ALPHA_SLICE = 3, 15
"""Channels of the samples of ETC1S: one number in red, green and blue, and alpha."""


def is_other(start: bytes) -> bool:
    """Whether a file with these first bytes is one of these images.

    Of DDS files those are that have half floats, that are older and have colours that are multiplied by alpha, and that
    have to be refused by the name of what they hold.
    """
    if start[: len(ktx2.IDENTIFIER)] == ktx2.IDENTIFIER or start[4:12] in _AVIF:
        return True
    head = dds.header(start)
    if head is None:
        return False
    older = head.dxgi is not None and head.size < dds.START
    return head.dxgi in _HALF_FLOATS or older or bool(head.several)


def header_of(data: bytes, path: Path) -> Header:
    """The header of an image, of the size of its stored texels; InputError where it is broken or of a kind that is not
    read."""
    if data[4:12] in _AVIF:
        pixels, said = _avif(data, path)
        height, width, channels = pixels.shape
        return Header(path, width, height, channels, _alpha(channels), "uint8", said)
    if data[:4] != dds.MAGIC:
        return _ktx2_header(data, path)
    texture, head = dds.decoded(data, str(path)), dds.header(data[:START])
    channels = texture.format.channels
    said = _dds_declared(head, channels, _alpha(channels))
    if texture.format.is_float:
        said = replace(said, colour=Colour(named=LINEAR, by="the file"))
    kept = len(said.channels) or channels
    depth = "half" if texture.format.is_float else "uint8"
    return Header(path, texture.width, texture.height, kept, _alpha(kept), depth, said)


def pixels_of(data: bytes, path: Path) -> NDArray[np.generic]:
    """(H, W, C) texels of level 0, uint8 or float16. InputError where they cannot be decoded."""
    if data[4:12] in _AVIF:
        return _avif(data, path)[0]
    try:
        if data[:4] == dds.MAGIC:
            texels = _finest(dds.decoded(data, str(path)))
            return texels[..., list(header_of(data, path).declared.channels) or slice(None)]
        found = ktx2.outline(data, str(path))
        if found.texels == ktx2.ETC1S:
            return np.asarray(_transcoded(data)[..., _etc1s(found)[0]])
        return _finest(ktx2.decoded(data, str(path)))
    except (MipbakeError, RuntimeError) as error:  # the transcoder of UASTC says RuntimeError
        message = one_line(str(error))
        raise InputError(message if str(path) in message else f"{path} cannot be decoded: {message}") from error


def _finest(texture: GpuTexture) -> NDArray[np.generic]:
    texels = from_blocks(replace(texture, levels=texture.levels[:1]))[0]
    if texels.dtype != np.float32:
        return texels
    return np.asarray(np.asarray(texels, np.float32) * np.float32(255) + np.float32(0.5), np.uint8)


def _alpha(channels: int) -> int:
    return 3 if channels == 4 else -1


def _avif(data: bytes, path: Path) -> tuple[NDArray[np.generic], Declared]:
    """(H, W, 1, 3 or 4) texels as stored, and what the file says of them; files of more than 8 bits come with 8."""
    from PIL import Image, features

    if not features.check("avif"):
        raise InputError(f"{path} is an AVIF image, which this build of Pillow does not read: convert it to PNG")
    try:
        with Image.open(io.BytesIO(data), formats=["AVIF"]) as image:
            texels, said = np.asarray(image), _avif_said(data, image)
    except (OSError, ValueError, RuntimeError, SyntaxError, struct.error, Image.DecompressionBombError) as error:
        raise InputError(
            f"{path} is damaged or cut short ({one_line(str(error))}): export or download it again"
        ) from error
    return (texels if texels.ndim == 3 else texels[..., None]), said


def _avif_said(data: bytes, image: ImageFile.ImageFile) -> Declared:
    """What the properties say. The decoder divides colours by alpha itself, where they are multiplied by it."""
    head = data[:_PROPERTIES]
    profile = image.info.get("icc_profile")
    warnings = []
    if (frames := getattr(image, "n_frames", 1)) > 1:
        warnings.append(f"it holds {frames} frames: only the first is read")
    if b"clap" in head:
        warnings.append("it asks to be cut (clap), which is ignored: cut it and export it again")
    notes = ("its values of more than 8 bits are read with 8",) if _is_deep(head) else ()
    return Declared(
        # Pillow gives the properties irot and imir as an orientation of Exif, and applies neither.
        orientation(image.getexif().get(_EXIF_ORIENTATION)),
        turn_is_pixels=True,
        colour=profile_colour(profile) if profile else _code_points(head),
        notes=notes,
        warnings=tuple(warnings),
    )


def _is_deep(head: bytes) -> bool:
    """Whether the configuration of the decoder says more than 8 bits."""
    at = head.find(b"av1C")
    return 0 <= at < len(head) - 6 and bool(head[at + 6] & 0x40)


def _code_points(head: bytes) -> Colour:
    at = head.find(b"colrnclx") + 8
    if at < 8 or at + 4 > len(head):
        return Colour()
    primaries, transfer = struct.unpack_from(">HH", head, at)
    return coded(primaries, transfer, "its property colr")


def _ktx2_header(data: bytes, path: Path) -> Header:
    found = ktx2.outline(data, str(path))
    if found.texels == ktx2.ETC1S and not found.several:
        taken, alpha = _etc1s(found)
        depth = "uint8"
    else:
        ktx2.stored(data, str(path))  # whether it is complete, and of a kind that is read
        assert found.format is not None
        taken, depth = found.format.decoded_channels, "half" if found.format.is_float else "uint8"
        alpha = _alpha(len(taken))
    warnings: list[str] = []
    turn = _text(found, "KTXorientation")
    if turn and turn[:2] not in _ORIENTATIONS:
        warnings.append(f"its KTXorientation is {turn!r}, expected one of {', '.join(_ORIENTATIONS)}: it is left out")
    letters, alpha = _swizzle(_text(found, "KTXswizzle"), taken, alpha, warnings)
    transfer, primaries = (
        words.get(number, f"code {number}")
        for words, number in ((_TRANSFERS, found.transfer), (_PRIMARIES, found.primaries))
    )
    said = Declared(
        orientation=_ORIENTATIONS.get(turn[:2], 1),
        texels_alone=True,
        swizzle=letters,
        alpha=PREMULTIPLIED if found.premultiplied and alpha >= 0 else STRAIGHT,
        colour=Colour(transfer, primaries, by="its data format descriptor"),
        notes=(f"its channels are {letters}, as its KTXswizzle says",) if letters else (),
        warnings=tuple(warnings),
    )
    return Header(path, *found.levels[0], len(letters) or len(taken), alpha, depth, said)


def _etc1s(found: ktx2.Outline) -> tuple[tuple[int, ...], int]:
    """The channels of decoded texels that a texture of ETC1S has, and the index of alpha; its second slice is decoded
    to alpha, whatever it holds."""
    colours = (0,) if found.channels[0] == _RED_SLICE else (0, 1, 2)
    second = found.channels[1:2]
    return (*colours, *(3 for _ in second)), len(colours) if second == (_ALPHA_SLICE,) else -1


def _transcoded(data: bytes) -> NDArray[np.uint8]:
    """(H, W, 4) texels of level 0 of a KTX 2 file whose texels are ETC1S, which glTF files of others may have, through
    the transcoder of Basis Universal. InputError where it is broken, UsageError where it is not installed."""
    try:
        import alktx2
    except ImportError:
        raise UsageError(
            "ETC1S needs the library of Basis Universal, alktx2, which mipbake's extra `etc1s` brings: "
            'python -m pip install "mipbake[etc1s]" (alktx2 has builds for Python 3.11 to 3.14 on x86-64 Linux and '
            "Windows; elsewhere give the textures as PNG files)"
        ) from None
    from PIL import Image

    try:
        with Image.open(io.BytesIO(alktx2.decode_ktx2_to_bytes(data, format="png", level=0)[0])) as image:
            return np.asarray(image.convert("RGBA"))
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"its blocks are broken ({one_line(str(error))}), export or download it again") from error


def _text(found: ktx2.Outline, key: str) -> str:
    return found.values.get(key, b"").rstrip(b"\0").decode("ascii", "replace")[:16]


def _swizzle(wanted: str, taken: tuple[int, ...], alpha: int, warnings: list[str]) -> tuple[str, int]:
    """The channels of an image by a KTXswizzle, in letters, none where they are as stored, and the index of alpha.
    Three equal colours are one, and an alpha of 1 is none. Graphics cards find 0 in colours that are not stored, and 1
    in an alpha.

    Args:
        wanted: four letters; empty for none. taken: the channels of decoded texels that the image has.
    """
    if not wanted:
        return "", alpha
    if not re.fullmatch("[rgba01]{4}", wanted):
        warnings.append(f"its KTXswizzle is {wanted!r}, expected four letters of rgba01: it is left out")
        return "", alpha
    # Where channels of decoded texels are left out, because they repeat red, letters mean others.
    others = {(0, 3): ("ab", "gr") if alpha < 0 else ("agb", "grr"), (0,): ("gb", "rr")}
    wanted = wanted.translate(str.maketrans(*others.get(taken, ("", ""))))
    stored = "rgba"[: len(taken)]
    there = "".join(c if c in f"{stored}01" else "1" if c == "a" else "0" for c in wanted)
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
        return _dds_declared(dds.header(file.read(dds.START)), spec.nchannels, spec.alpha_channel)


def _dds_declared(head: dds.Header | None, channels: int, alpha: int) -> Declared:
    """What a header of DDS says of an image of so many channels."""
    if head is None or alpha < 0:
        return Declared()
    if head.alpha == dds.OPAQUE:
        kept = tuple(index for index in range(channels) if index != alpha)
        return Declared(
            channels=kept, notes=("its alpha is left out, because its header says that the image is opaque",)
        )
    if head.alpha == dds.CUSTOM:
        return Declared(alpha=CUSTOM, notes=("its alpha is no opacity, as its header says",))
    return Declared(alpha=PREMULTIPLIED if head.alpha == dds.PREMULTIPLIED else STRAIGHT)
