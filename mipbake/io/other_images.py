"""Images that OpenImageIO does not read: AVIF, and level 0 of KTX 2 textures and of DDS ones of half floats."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mipbake.errors import InputError, MipbakeError
from mipbake.io import avif, dds, ktx2
from mipbake.io.blocks import from_blocks
from mipbake.io.colour import LINEAR, SRGB
from mipbake.io.declared import Declared
from mipbake.io.declared_colour import Colour
from mipbake.io.gpu_format import GPU_FORMATS, GpuTexture
from mipbake.io.messages import one_line
from mipbake.io.uastc import transcoded

_AVIF = (b"ftypavif", b"ftypavis")
START = 132
"""Bytes of a file that tell whether it is one of these."""

_HALF_FLOATS = tuple(made.dxgi for made in GPU_FORMATS.values() if made.is_float)


@dataclass(frozen=True)
class Outline:
    """What is known of an image before its texels are.

    Args:
        width, height: of level 0, in texels.
        channels: how many. alpha: the index of alpha; -1: none.
        depth: "uint8" or "half".
        declared: what the file says of the image. Size and channels here are those of the stored texels, before it is
            applied.
    """

    width: int
    height: int
    channels: int
    alpha: int
    depth: str
    declared: Declared


def is_other(start: bytes) -> bool:
    """Whether a file with these first bytes is one of these images."""
    return start[: len(ktx2.IDENTIFIER)] == ktx2.IDENTIFIER or start[4:12] in _AVIF or _is_half_dds(start)


def _is_half_dds(start: bytes) -> bool:
    dxgi = int.from_bytes(start[128:132], "little")
    return start[:4] == b"DDS " and start[84:88] == b"DX10" and dxgi in _HALF_FLOATS


def outline(data: bytes, path: Path) -> Outline:
    """What is known of an image. InputError where it is broken or of a kind that is not read."""
    if data[4:12] in _AVIF:
        pixels, said = avif.decoded(data, path)
        return Outline(pixels.shape[1], pixels.shape[0], pixels.shape[2], _alpha(pixels.shape[2]), "uint8", said)
    if data[:4] == b"DDS ":
        texture = dds.decoded(data, str(path))
        count = texture.format.channels
        return Outline(texture.width, texture.height, count, _alpha(count), "half", _in(LINEAR))
    found = ktx2.outline(data, str(path))
    said = _in(SRGB if found.srgb else LINEAR)
    width, height = found.levels[0]
    if found.texels == ktx2.ETC1S:
        channels = 4 if ktx2.has_alpha_slice(data) else 3
        return Outline(width, height, channels, _alpha(channels), "uint8", said)
    made = ktx2.stored(data, str(path)).format
    depth = "half" if made.is_float else "uint8"
    return Outline(width, height, made.channels, _alpha(made.channels), depth, said)


def _in(space: str) -> Declared:
    return Declared(colour=Colour(named=space, by="the file"))


def pixels_of(data: bytes, path: Path) -> NDArray[np.generic]:
    """(H, W, C) texels of level 0, uint8 or float16. InputError where they cannot be decoded."""
    if data[4:12] in _AVIF:
        return avif.decoded(data, path)[0]
    try:
        if data[:4] == b"DDS ":
            return from_blocks(_finest(dds.decoded(data, str(path))))[0]
        if ktx2.outline(data, str(path)).texels == ktx2.ETC1S:
            texels: NDArray[np.generic] = transcoded(data)[..., : outline(data, path).channels]
            return texels
        return from_blocks(_finest(ktx2.decoded(data, str(path))))[0]
    except (MipbakeError, RuntimeError) as error:  # the transcoder of UASTC says RuntimeError
        told = one_line(str(error))
        raise InputError(told if str(path) in told else f"{path} cannot be decoded: {told}") from error


def _finest(texture: GpuTexture) -> GpuTexture:
    return replace(texture, levels=texture.levels[:1])


def _alpha(channels: int) -> int:
    return 3 if channels == 4 else -1
