"""BC7 blocks by etcpak, in a process of their own: its encoder keeps the interpreter for itself while it works."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_INLINE = 1 << 15
"""So many texels are encoded sooner (0.02 s) than a process starts."""

# Without the working directory: files of the user's are no modules.
_WORKER = """
import sys
sys.path[:] = [entry for entry in sys.path if entry]
import struct
import etcpak
settings = etcpak.BC7CompressBlockParams()
settings.init_linear_weights()
while len(head := sys.stdin.buffer.read(8)) == 8:
    width, height = struct.unpack("<2I", head)
    sys.stdout.buffer.write(etcpak.compress_bc7(sys.stdin.buffer.read(4 * width * height), width, height, settings))
    sys.stdout.buffer.flush()
"""


def compressed(levels: Sequence[NDArray[np.generic]]) -> tuple[bytes, ...]:
    """(H, W, 4) uint8 levels, sides multiples of 4, to their blocks. Threads may call it at the same time."""
    if sum(level.shape[0] * level.shape[1] for level in levels) <= _INLINE:
        return _here(levels)
    given = b"".join(
        level.shape[1].to_bytes(4, "little") + level.shape[0].to_bytes(4, "little") + level.tobytes()
        for level in levels
    )
    sizes = [level.shape[0] * level.shape[1] for level in levels]
    try:
        done = subprocess.run(
            [sys.executable, "-c", _WORKER], input=given, capture_output=True, check=False, cwd=Path(__file__).parent
        )
    except OSError:  # no interpreter of that name: mipbake runs inside another program
        return _here(levels)
    if done.returncode or len(done.stdout) != sum(sizes):
        return _here(levels)
    ends = np.cumsum(sizes)
    return tuple(done.stdout[end - size : end] for end, size in zip(ends, sizes, strict=True))


def _here(levels: Sequence[NDArray[np.generic]]) -> tuple[bytes, ...]:
    import etcpak

    settings = etcpak.BC7CompressBlockParams()
    settings.init_linear_weights()  # maps are data as often as colours, and 1.4 dB better for both
    return tuple(
        bytes(etcpak.compress_bc7(np.ascontiguousarray(level).tobytes(), level.shape[1], level.shape[0], settings))
        for level in levels
    )
