"""Images that OpenImageIO does not read: AVIF, level 0 of KTX 2 textures, and of some DDS ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.base.colour import LINEAR
from mipbake.base.errors import InputError, MipbakeError
from mipbake.base.messages import one_line
from mipbake.source.images import avif, dds, ktx2
from mipbake.source.images.blocks import from_blocks
from mipbake.source.images.declared import Declared
from mipbake.source.images.declared_colour import Colour
from mipbake.source.images.gpu_format import GPU_FORMATS, GpuTexture
from mipbake.source.images.gpu_says import ktx2_said, of_header
from mipbake.source.images.uastc import transcoded

_AVIF = (b"ftypavif", b"ftypavis")
START = dds.START
"""Bytes of a file that tell whether it is one of these."""

_HALF_FLOATS = tuple(made.dxgi for made in GPU_FORMATS.values() if made.is_float)


@dataclass(frozen=True)
class Outline:
    """What is known of an image before its texels are.

    Args:
        width, height: of level 0, in texels.
        channels: how many. alpha: the index of alpha; -1: none.
        depth: "uint8" or "half".
        declared: what the file says of the image. The size here is that of the stored texels, before it is applied.
    """

    width: int
    height: int
    channels: int
    alpha: int
    depth: str
    declared: Declared


def is_other(start: bytes) -> bool:
    """Whether a file with these first bytes is one of these images."""
    return start[: len(ktx2.IDENTIFIER)] == ktx2.IDENTIFIER or start[4:12] in _AVIF or _is_other_dds(start)


def _is_other_dds(start: bytes) -> bool:
    """Whether a DDS file has half floats, is older and has colours that are multiplied by alpha, or has to be refused
    by the name of what it holds."""
    head = dds.header(start)
    if head is None:
        return False
    older = head.dxgi is not None and head.size < dds.START
    return head.dxgi in _HALF_FLOATS or older or bool(head.several)


def outline(data: bytes, path: Path) -> Outline:
    """What is known of an image. InputError where it is broken or of a kind that is not read."""
    if data[4:12] in _AVIF:
        pixels, said = avif.decoded(data, path)
        return Outline(pixels.shape[1], pixels.shape[0], pixels.shape[2], _alpha(pixels.shape[2]), "uint8", said)
    if data[:4] == dds.MAGIC:
        texture, head = dds.decoded(data, str(path)), dds.header(data[:START])
        count, half = texture.format.channels, texture.format.is_float
        said = Declared() if head is None else of_header(head, count, _alpha(count))
        said = replace(said, colour=Colour(named=LINEAR, by="the file") if half else Colour())
        depth = "half" if half else "uint8"
        kept = len(said.channels) or count
        return Outline(texture.width, texture.height, kept, _alpha(kept), depth, said)
    found = ktx2.outline(data, str(path))
    ktx2.check_single(found.several, str(path))
    if found.texels == ktx2.ETC1S:
        taken, alpha, depth = found.channels, found.alpha, "uint8"
    else:
        made = ktx2.stored(data, str(path)).format
        taken, depth = made.decoded_channels, "half" if made.is_float else "uint8"
        alpha = _alpha(len(taken))
    said, count, alpha = ktx2_said(found, len(taken), alpha, _lost(taken, alpha))
    return Outline(*found.levels[0], count, alpha, depth, said)


def _lost(taken: tuple[int, ...], alpha: int) -> str:
    """Which letters of a swizzle mean what, where channels of decoded texels are left out, because they repeat red."""
    if taken == (0, 3):
        return "agbr" if alpha < 0 else "aggrbr"
    return "grbr" if taken == (0,) else ""


def pixels_of(data: bytes, path: Path) -> NDArray[np.generic]:
    """(H, W, C) texels of level 0, uint8 or float16. InputError where they cannot be decoded."""
    if data[4:12] in _AVIF:
        return avif.decoded(data, path)[0]
    try:
        if data[:4] == dds.MAGIC:
            texels = from_blocks(_finest(dds.decoded(data, str(path))))[0]
            return texels[..., list(outline(data, path).declared.channels) or slice(None)]
        found = ktx2.outline(data, str(path))
        if found.texels == ktx2.ETC1S:
            return np.asarray(transcoded(data)[..., found.channels])
        return from_blocks(_finest(ktx2.decoded(data, str(path))))[0]
    except (MipbakeError, RuntimeError) as error:  # the transcoder of UASTC says RuntimeError
        told = one_line(str(error))
        raise InputError(told if str(path) in told else f"{path} cannot be decoded: {told}") from error


def _finest(texture: GpuTexture) -> GpuTexture:
    return replace(texture, levels=texture.levels[:1])


def _alpha(channels: int) -> int:
    return 3 if channels == 4 else -1
