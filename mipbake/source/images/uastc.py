"""UASTC blocks by Basis Universal: what glTF files hold, and graphics cards get transcoded to a format of theirs."""

from __future__ import annotations

import io
from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import one_line
from mipbake.source.images import ktx2
from mipbake.source.images.gpu_format import GpuFormat, GpuTexture, level_size

_QUALITY, _EFFORT = 100, 3
"""The best quality; effort 5 takes two to three times as long for nothing, 9 over a hundred times for 0.1 to 0.2 dB."""


def check_encoder() -> None:
    """UsageError where the encoder is not installed."""
    _library()


def compressed(levels: Sequence[NDArray[np.generic]], made: GpuFormat) -> tuple[bytes, ...]:
    """(H, W, 4) uint8 levels of a whole chain to their blocks."""
    encoder = _library()
    given = [(np.ascontiguousarray(level).tobytes(), level.shape[1], level.shape[0]) for level in levels]
    data = encoder.encode_raw_mips_to_ktx2(
        given,
        has_alpha=made.channels == 4,
        codec="uastc",
        quality=_QUALITY,
        effort=_EFFORT,
        srgb=made.srgb,
        linear=not made.srgb,
        threads=1,  # maps are encoded side by side already
        check_for_alpha=False,
        force_alpha=made.channels == 4,
    )
    return ktx2.decoded(data, "the encoder's file").levels


def decompressed(texture: GpuTexture) -> list[NDArray[np.generic]]:
    """(H, W, 4) uint8 texels of every level."""
    data = ktx2.encoded(texture, supercompress=False)
    levels: list[NDArray[np.generic]] = []
    for index in range(len(texture.levels)):
        width, height = level_size(texture.width, texture.height, index)
        levels.append(_level(data, index)[:height, :width])  # whole blocks come back
    return levels


def transcoded(data: bytes) -> NDArray[np.uint8]:
    """(H, W, 4) texels of level 0 of a KTX 2 file whose texels are ETC1S.

    Raises:
        InputError: the file is broken. UsageError: the transcoder is not installed.
    """
    try:
        return _level(data, 0)
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"its blocks are broken ({one_line(str(error))}), export or download it again") from error


def _level(data: bytes, index: int) -> NDArray[np.uint8]:
    """(H, W, 4) texels of a level of a KTX 2 file."""
    from PIL import Image

    with Image.open(io.BytesIO(_library().decode_ktx2_to_bytes(data, format="png", level=index)[0])) as image:
        return np.asarray(image.convert("RGBA"))


def _library() -> ModuleType:
    try:
        import alktx2
    except ImportError:
        raise UsageError(
            "UASTC and ETC1S need the library of Basis Universal, alktx2, which mipbake's extra `uastc` brings: "
            'python -m pip install "mipbake[uastc]" (alktx2 has builds for Python 3.11 to 3.14 on x86-64 Linux and '
            "Windows; elsewhere choose other files, such as --format exr or ktx2:bc)"
        ) from None
    return alktx2
