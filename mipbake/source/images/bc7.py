"""BC7 blocks by etcpak, in a process of their own: its encoder keeps the interpreter for itself while it works."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_INLINE = 1 << 15
"""So many texels are encoded sooner (0.02 s) than a process starts."""

# Without the working directory: files of the user are not modules.
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


_AT_ONCE = 1 << 13
"""So many blocks are changed at a time, which takes some kilobytes for each."""

_STEPS = np.array([0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64]) / 64
"""Where the indices of mode 6 lie between the ends of a block."""


def compressed(images: Iterable[NDArray[np.uint8]], exactly_opaque: bool = False) -> Iterator[bytes]:
    """(H, W, 4) images, sides multiples of 4, to the blocks of each. Threads may call it at the same time.

    With `exactly_opaque`, for colours, blocks of opaque texels have an alpha of 1 and not of 254 / 255, which takes a
    bit from some of the colours.
    """
    process: subprocess.Popen[bytes] | None = None
    alone = False  # whether no process can be started, or it has ended
    try:
        for image in images:
            texels = image.shape[0] * image.shape[1]
            blocks = b""
            if not alone and (process is not None or texels > _INLINE):
                with suppress(OSError):  # no interpreter of that name: mipbake runs inside another program
                    process = process or _started()
                    blocks = _sent(process, image)
                alone = len(blocks) != texels
            if len(blocks) != texels:
                blocks = _here(image)
            yield _opaque(blocks, image) if exactly_opaque else blocks
    finally:
        if process is not None:
            with suppress(OSError), process:  # what could not be sent is still in its pipe
                process.kill()


def _started() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _WORKER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=Path(__file__).parent,
    )


def _sent(process: subprocess.Popen[bytes], image: NDArray[np.uint8]) -> bytes:
    """What a process answers to an image; less where it has ended."""
    height, width = image.shape[:2]
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(struct.pack("<2I", width, height) + image.tobytes())
    process.stdin.flush()
    return process.stdout.read(height * width)


def _here(image: NDArray[np.uint8]) -> bytes:
    import etcpak

    settings = etcpak.BC7CompressBlockParams()
    settings.init_linear_weights()  # maps are data as often as colours, and 1.4 dB better for both
    return bytes(etcpak.compress_bc7(image.tobytes(), image.shape[1], image.shape[0], settings))


def _opaque(blocks: bytes, level: NDArray[np.generic]) -> bytes:
    """Blocks of opaque texels with an alpha of 1, which etcpak leaves at 254 / 255 in some of mode 6.

    In mode 6 all channels of an end share their last bit: it is set, and each colour becomes the better of the odd
    values beside it.
    """
    data = np.frombuffer(blocks, np.uint8).reshape(-1, 16)
    rows, columns = level.shape[0] // 4, level.shape[1] // 4
    solid = (level[..., 3] == 255).reshape(rows, 4, columns, 4).all((1, 3)).ravel()
    whole = (data[:, 6] >= 254) & (data[:, 7] == 255) & (data[:, 8] & 1 == 1)  # the bits 49 to 64: alpha, last bits
    found = np.flatnonzero(solid & ((data[:, 0] & 127) == 64) & ~whole)
    if not len(found):
        return blocks
    out = data.copy()
    for part in np.array_split(found, -(-len(found) // _AT_ONCE)):
        texels = np.stack([level[4 * (i // columns) :, 4 * (i % columns) :][:4, :4, :3] for i in part])
        out[part] = _with_last_bits(data[part], texels.reshape(-1, 16, 3))
    return bytes(out)


def _with_last_bits(data: NDArray[np.uint8], texels: NDArray[np.generic]) -> NDArray[np.uint8]:
    """(N, 16) blocks of mode 6 with alpha and all last bits set, and the colours that suit (N, 16, 3) texels."""
    wanted = np.moveaxis(texels.astype(np.float32), 2, 1)
    bits = np.unpackbits(data, axis=1, bitorder="little")
    ends = bits[:, 7:49].reshape(-1, 3, 2, 7) @ (1 << np.arange(7))
    # The first texel has one bit less, its highest.
    share = _STEPS[np.insert(bits[:, 65:], 3, 0, axis=1).reshape(-1, 1, 16, 4) @ (1 << np.arange(4))]
    trials = np.stack([np.maximum(ends - step, 0) for step in ([0, 0], [0, 1], [1, 0], [1, 1])])
    low, high = np.moveaxis(2 * trials + 1, -1, 0)[..., None]
    errors = np.square(low + (high - low) * share - wanted).sum(-1)
    best = np.take_along_axis(trials, errors.argmin(0)[None, ..., None], 0)[0]
    bits[:, 7:49] = (best[..., None] >> np.arange(7) & 1).reshape(-1, 42)
    bits[:, 49:65] = 1
    return np.packbits(bits, axis=1, bitorder="little")
