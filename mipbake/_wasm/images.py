"""Resampling and compressed blocks in the core as WebAssembly."""

from __future__ import annotations

from typing import Any

import numpy as np

from mipbake._wasm.given import checked, filled, indices, number_of
from mipbake._wasm.machine import run

_BLOCKS = {
    "bc1": (8, 4),
    "bc2": (16, 4),
    "bc3": (16, 4),
    "bc4": (8, 1),
    "bc5": (16, 2),
    "bc7": (16, 4),
    "uastc": (16, 4),
}
"""Formats in the order of csrc/ops/blocks.h to bytes of a block and channels."""


def resample(image: Any, row_index: Any, row_weights: Any, column_index: Any, column_weights: Any, out: Any) -> None:
    height, width, C = np.shape(image)
    words: list[Any] = []
    for index, weights, size in ((row_index, row_weights, height), (column_index, column_weights, width)):
        count, taps = np.shape(index)
        words += [indices("index", index, np.int64, (count, taps), size)]
        words += [checked("weights", weights, np.float32, (count, taps)), count, taps]
    texels = checked("image", image, np.float32, (height, width, C))
    made = filled("out", out, np.float32, (len(row_index), len(column_index), C))
    run("resample", texels, [width * C, width, C], words, made)


def encode_blocks(format: str, values: Any, weights: Any, blocks: Any) -> None:
    height, width, _ = np.shape(values)
    if format in ("bc2", "bc3") or not height or not width:
        raise ValueError("no texels, or a format that is not written")
    index, image, shape = _block_shapes(format, height, width)
    texels = checked("values", values, np.float32, image), checked("weights", weights, np.float32, image)
    run("encode_blocks", [index, height, width], texels, filled("blocks", blocks, np.uint8, shape))


def decode_blocks(format: str, blocks: Any, values: Any) -> None:
    height, width, _ = np.shape(values)
    index, image, shape = _block_shapes(format, height, width)
    given = checked("blocks", blocks, np.uint8, shape)
    run("decode_blocks", [index, height, width], given, filled("values", values, np.float32, image))


def _block_shapes(name: str, height: int, width: int) -> tuple[int, tuple[int, int, int], tuple[int, int]]:
    """The index of a format, and the shapes of texels and blocks."""
    index = number_of("format of blocks", name, list(_BLOCKS))
    size, channels = _BLOCKS[name]
    return index, (height, width, channels), (-(-height // 4) * -(-width // 4), size)
