"""BC4 blocks: 4 x 4 texels of one channel as two ends of 8 bits, and 3 bits a texel between them.

The ends are the least and the greatest value of a block. Two blocks of BC4 are one of BC5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_CODES = np.array([1, 7, 6, 5, 4, 3, 2, 0], np.uint8)
"""What is stored for each of the eight values from the least to the greatest."""


def compressed(level: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W) texels, sides multiples of 4, to (H / 4 * W / 4, 8) bytes, row by row."""
    rows, columns = level.shape[0] // 4, level.shape[1] // 4
    texels = level.reshape(rows, 4, columns, 4).swapaxes(1, 2).reshape(-1, 16).astype(np.int32)
    greatest, least = texels.max(1), texels.min(1)
    span = np.maximum(greatest - least, 1)[:, None]
    codes = _CODES[(7 * (texels - least[:, None]) + span // 2) // span]
    codes[greatest == least] = 0  # such a block has other values between its ends, but both ends are right
    bits = codes[..., None] >> np.arange(3, dtype=np.uint8) & 1
    ends = np.stack([greatest, least], 1).astype(np.uint8)
    return np.concatenate([ends, np.packbits(bits.reshape(-1, 48), axis=1, bitorder="little")], 1)
