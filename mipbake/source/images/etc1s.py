"""ETC1S texels, which glTF files of others may have, through the transcoder of Basis Universal."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import one_line


def transcoded(data: bytes) -> NDArray[np.uint8]:
    """(H, W, 4) texels of level 0 of a KTX 2 file whose texels are ETC1S. InputError where it is broken, UsageError
    where the transcoder is not installed."""
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
