"""What is read back of a file, to be compared with what is in memory anyway."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Band(NamedTuple):
    """Some rows of a level: their texels, (rows, W, channels)."""

    level: int
    rows: slice
    texels: NDArray[np.generic]


def whole_levels(levels: Sequence[NDArray[np.generic]]) -> Iterator[Band]:
    """Levels as a band each."""
    return (Band(index, slice(0, len(level)), level) for index, level in enumerate(levels))
