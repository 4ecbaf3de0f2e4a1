"""Whether a PNG is whole."""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import BinaryIO

from mipbake.base.errors import InputError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def check_png(path: Path, file: BinaryIO) -> None:
    """InputError for a PNG whose chunks are damaged or cut short: libpng fills what is missing silently, or prints to
    the standard error itself.
    """
    size, at = file.seek(0, os.SEEK_END), len(PNG_SIGNATURE)
    while at + 12 <= size:
        file.seek(at)
        length = int.from_bytes(file.read(4), "big")
        if at + 12 + length > size:
            break
        chunk = file.read(4 + length)
        if zlib.crc32(chunk) != int.from_bytes(file.read(4), "big"):
            name = chunk[:4].decode("ascii", "replace")
            raise InputError(f"{path} is damaged (checksum of {name} at byte {at}): export or download it again")
        if chunk[:4] == b"IEND":
            return
        at += 12 + length
    raise InputError(f"{path} is cut short after {size} bytes: export or download it again")
