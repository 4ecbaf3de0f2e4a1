"""AVIF images, which Pillow decodes, and what they say of themselves."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError
from mipbake.base.messages import one_line
from mipbake.source.images.declared import Declared, orientation
from mipbake.source.images.declared_colour import Colour, coded
from mipbake.source.images.icc import profile_colour

if TYPE_CHECKING:
    from PIL import ImageFile

_ORIENTATION = 0x112
"""Number of the tag, in Exif."""

_PROPERTIES = 1 << 16
"""Bytes at the beginning that hold the properties of an image."""


def decoded(data: bytes, path: Path) -> tuple[NDArray[np.generic], Declared]:
    """(H, W, 1, 3 or 4) texels as stored, and what the file says of them; files of more than 8 bits come with 8."""
    from PIL import Image, features

    if not features.check("avif"):
        raise InputError(f"{path} is an AVIF image, which this build of Pillow does not read: convert it to PNG")
    try:
        with Image.open(io.BytesIO(data), formats=["AVIF"]) as image:
            texels, said = np.asarray(image), _said(data, image)
    except (OSError, ValueError, RuntimeError, SyntaxError, struct.error, Image.DecompressionBombError) as error:
        raise InputError(
            f"{path} is damaged or cut short ({one_line(str(error))}): export or download it again"
        ) from error
    return (texels if texels.ndim == 3 else texels[..., None]), said


def _said(data: bytes, image: ImageFile.ImageFile) -> Declared:
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
        orientation(image.getexif().get(_ORIENTATION)),
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
